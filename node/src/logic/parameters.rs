//! Parameters of running programs: their names and values, and whether a key of the database is such a parameter.

use crate::logic::database::settings::{parameter_key, stands_for};
use crate::logic::protocol::{InstanceParameters, ParameterStatus};
use language::plan::{Accepts, Argument, BRIDGE_PROGRAM, Constant, Parameter, ROS_NODE, words};
use std::collections::BTreeMap;

/// The verdict on a key below `robot/HOST/params/` and a value for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The name is a parameter, and takes the value.
    Fits,
    /// The name is unknown at present. The sentence gives the reason.
    Unknown(String),
    /// The name is not a parameter, or the parameter does not accept the value. The sentence gives the reason.
    Refused(String),
}

/// Returns the parameters of an instance with the values from its plan.
pub fn given(parameters: &[Parameter], arguments: &[Argument]) -> Vec<ParameterStatus> {
    let mut places = parameters.iter().map(|parameter| parameter.name.as_str());
    let values: BTreeMap<&str, &Constant> = arguments
        .iter()
        .filter_map(|argument| Some((argument.name.as_deref().or_else(|| places.next())?, &argument.value)))
        .collect();
    let status = |parameter: &Parameter| ParameterStatus {
        given: values.get(parameter.name.as_str()).map(|value| (*value).clone()),
        parameter: parameter.clone(),
    };
    parameters.iter().map(status).collect()
}

/// Returns the parameters of a plain program that users may ask for: its secrets. A running program does not get a new value.
pub fn of_plain(arguments: &[Argument]) -> Vec<Parameter> {
    let secrets = arguments.iter().filter(|argument| matches!(argument.value, Constant::Secret(_)));
    secrets.filter_map(|argument| Some(Parameter { name: argument.name.clone()?, accepts: Accepts::Secret })).collect()
}

/// Returns parameters of the database in the form for their program, with quantities as numbers in SI units. A value
/// that the program would not accept is left unchanged, and the program refuses it.
pub fn in_si(declared: &[Parameter], mut stored: Vec<(String, String)>) -> Vec<(String, String)> {
    for (name, text) in &mut stored {
        let declared = declared.iter().find(|parameter| parameter.name == *name);
        if let Some(Ok(read)) = declared.map(|parameter| parameter.accepts.read(text)) {
            *text = read;
        }
    }
    stored
}

/// Returns the robot to whose parameter a key would belong; none if the key is not below `robot/HOST/params/`.
pub fn robot_of(key: &str) -> Option<&str> {
    let (robot, below) = key.strip_prefix("robot/")?.split_once('/')?;
    (below == "params" || below.starts_with("params/")).then_some(robot)
}

/// Checks whether a key is a parameter of a program that runs on the key's robot, and whether the parameter accepts the
/// value. `known` is the report of the robot's node about its programs.
pub fn check(key: &str, text: &str, known: &[InstanceParameters]) -> Verdict {
    let Some((robot, deployment, instance, name)) = parameter_key(key) else {
        return Verdict::Refused(format!(
            "`{key}` is not a parameter: `robot/HOST/params/DEPLOYMENT/INSTANCE/PARAMETER`"
        ));
    };
    let deployed: Vec<&InstanceParameters> = known.iter().filter(|one| one.deployment.name == deployment).collect();
    if deployed.is_empty() {
        return Verdict::Unknown(format!(
            "`{deployment}` does not run on `{robot}` now, so it is not known whether `{instance}` has a parameter `{name}`"
        ));
    }
    let meant: Vec<&&InstanceParameters> = deployed.iter().filter(|one| stands_for(instance, &one.path)).collect();
    if meant.is_empty() {
        let all: Vec<&str> = deployed.iter().map(|one| without_main(&one.path)).collect();
        let hint = near(instance, &all).map_or_else(|| format!("there are {}", listed(&all)), did_you_mean);
        return Verdict::Refused(format!("`{deployment}` has no program `{instance}` on `{robot}`; {hint}"));
    }
    let mut why = None;
    for one in meant {
        let Some(parameters) = &one.parameters else {
            let path = without_main(&one.path);
            why = Some(Verdict::Unknown(format!("`{path}` does not say what parameters it has")));
            continue;
        };
        match parameters.iter().find(|status| status.parameter.name == name) {
            Some(status) => match status.parameter.accepts.check(text) {
                Ok(()) => return Verdict::Fits,
                Err(expected) => {
                    why = Some(Verdict::Refused(format!("`{name}` cannot be `{text}`: expected {expected}")));
                }
            },
            None => {
                let unknown = || Verdict::Refused(no_parameter(one, parameters, name));
                why.get_or_insert_with(unknown);
            }
        }
    }
    why.unwrap_or(Verdict::Fits)
}

/// Returns a sentence for each parameter of a plan to which the database gives another value than the spec. `keys` has
/// the values in the spelling of a spec.
pub fn overruled(keys: &[(String, String)], known: &[InstanceParameters]) -> Vec<String> {
    let mut sentences = Vec::new();
    for one in known {
        for status in one.parameters.iter().flatten() {
            let name = &status.parameter.name;
            let is_meant = |key: &str| {
                let parts = parameter_key(key).filter(|(_, deployment, ..)| *deployment == one.deployment.name);
                parts.is_some_and(|(_, _, instance, of)| of == name && stands_for(instance, &one.path))
            };
            // If several keys name the instance, the key with the longest path is used.
            let stored = keys.iter().filter(|(key, _)| is_meant(key)).max_by_key(|(key, _)| key.len());
            let (Some((key, text)), Some(given)) = (stored, &status.given) else { continue };
            let accepts = &status.parameter.accepts;
            let read = accepts.read(text);
            if !is_same(given, read.as_ref().unwrap_or(text)) {
                let unit = accepts.unit().map(|unit| format!(" {unit}")).unwrap_or_default();
                let (path, given) = (without_main(&one.path), format!("{}{unit}", given.bare()));
                let text = read.map_or_else(|_| text.clone(), |read| format!("{read}{unit}"));
                let unset = format!("dca param unset {}:{path} {name}", one.deployment.name);
                sentences
                    .push(format!("`{key}` is {text} in the database, the spec says {given}; `{unset}` removes it"));
            }
        }
    }
    sentences
}

fn is_same(given: &Constant, text: &str) -> bool {
    match given {
        Constant::Number(number) => text.parse::<f64>().is_ok_and(|other| other.total_cmp(number).is_eq()),
        Constant::Text(_) | Constant::Truth(_) | Constant::Secret(_) => given.bare() == text,
    }
}

/// Returns the sentence that an instance has no such parameter. The sentence also lists its parameters.
pub fn no_parameter(instance: &InstanceParameters, parameters: &[ParameterStatus], name: &str) -> String {
    let all: Vec<&str> = parameters.iter().map(|status| status.parameter.name.as_str()).collect();
    let (path, module) = (without_main(&instance.path), &instance.module);
    let hint = match near(name, &all) {
        Some(near) => did_you_mean(near),
        None if all.is_empty() => "it has none".to_owned(),
        None => format!("it has {}", listed(&all)),
    };
    format!("`{path}`, which is a {module}, has no parameter `{name}` to change; {hint}")
}

/// If an `exec` starts the program for a node of ROS 2, returns the name of that node, as far as the spec gives it.
pub fn ros_node(exec: &str) -> Option<String> {
    let words = words(exec).ok()?;
    let [program, kind, rest @ ..] = words.as_slice() else { return None };
    let own = rest.iter().take_while(|word| *word != "--");
    let node = own.filter_map(|word| word.strip_prefix("node=")).next();
    node.filter(|_| program == BRIDGE_PROGRAM && kind == ROS_NODE).map(str::to_owned)
}

/// Returns a path without `main`.
pub fn without_main(path: &str) -> &str {
    path.split_once('/').map_or(path, |(_main, rest)| rest)
}

fn did_you_mean(near: &str) -> String {
    format!("did you mean `{near}`?")
}

/// How many names a sentence lists at most.
const LISTED_MAX: usize = 12;

fn listed(names: &[&str]) -> String {
    let shown: Vec<String> = names.iter().take(LISTED_MAX).map(|name| format!("`{name}`")).collect();
    let more = names.len().saturating_sub(LISTED_MAX);
    if more > 0 { format!("{} and {more} more", shown.join(", ")) } else { shown.join(", ") }
}

/// Returns the name that the user probably meant.
fn near<'a>(name: &str, all: &[&'a str]) -> Option<&'a str> {
    language::nearest(name, all.iter().copied()).or_else(|| all.iter().copied().find(|one| stands_for(name, one)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::protocol::Deployment;

    fn instance(path: &str, parameters: Option<&[(&str, Accepts)]>) -> InstanceParameters {
        let deployment = Deployment { name: "door".into(), epoch: 1 };
        let status = |(name, accepts): &(&str, Accepts)| ParameterStatus {
            parameter: Parameter { name: (*name).to_owned(), accepts: accepts.clone() },
            given: None,
        };
        let parameters = parameters.map(|all| all.iter().map(status).collect());
        InstanceParameters { deployment, path: path.into(), module: "Sensor".into(), parameters, ros_node: None }
    }

    #[test]
    fn a_node_of_ros_is_known_by_its_command() {
        for (exec, node) in [
            ("dca-ros RosNode package=a executable=b node=/r1/nav stop_ms=5000 -- 0", Some("/r1/nav")),
            ("dca-ros RosNode restarts=true package=a node=/nav -- 1 x", Some("/nav")),
            ("dca-ros RosNode package=a executable=b -- 1 node=/other", None),
            ("dca-ros RosBridge node=/nav", None),
            ("other RosNode node=/nav", None),
            ("'", None),
        ] {
            assert_eq!(ros_node(exec).as_deref(), node, "{exec}");
        }
    }

    #[test]
    fn a_secret_of_a_plain_program_is_known_and_takes_no_value() {
        let argument = |name: &str, value| Argument { name: Some(name.to_owned()), value };
        let arguments =
            [argument("password", Constant::Secret("team/password".into())), argument("rate", Constant::Number(5.0))];
        let parameters = Some(given(&of_plain(&arguments), &arguments));
        let known = [InstanceParameters { parameters, ..instance("main/camera", None) }];
        let why = "`password` cannot be `1`: expected `secret(\"KEY\")` in the spec";
        let verdict = check("robot/c3/params/door/camera/password", "1", &known);
        assert_eq!(verdict, Verdict::Refused(why.to_owned()));
    }

    #[test]
    fn a_key_is_compared_with_what_runs() {
        let force = [("threshold", Accepts::Between { low: Some(0.0), high: Some(200.0) }), ("zero", Accepts::Truth)];
        let known = [instance("main/task/hit/force", Some(&force)), instance("main/task/say", None)];
        let says = |key: &str, text: &str| match check(&format!("robot/c3/params/{key}"), text, &known) {
            Verdict::Fits => "fits".to_owned(),
            Verdict::Unknown(why) | Verdict::Refused(why) => why,
        };
        for key in ["door/task/hit/force/threshold", "door/hit/force/threshold", "door/force/threshold"] {
            assert_eq!(says(key, "12.0"), "fits", "{key}");
        }
        for (key, text, why) in [
            ("door/hit/force/threshold", "500", "`threshold` cannot be `500`: expected a number from 0 to 200"),
            ("door/hit/force/zero", "1", "`zero` cannot be `1`: expected `true` or `false`"),
            (
                "door/hit/force/treshold",
                "12",
                "`task/hit/force`, which is a Sensor, has no parameter `treshold` to change; did you mean `threshold`?",
            ),
            (
                "door/hit/forse/threshold",
                "12",
                "`door` has no program `hit/forse` on `c3`; there are `task/hit/force`, `task/say`",
            ),
            ("door/say/text", "12", "`task/say` does not say what parameters it has"),
            (
                "gate/hit/force/threshold",
                "12",
                "`gate` does not run on `c3` now, so it is not known whether `hit/force` has a parameter `threshold`",
            ),
            (
                "door/threshold",
                "12",
                "`robot/c3/params/door/threshold` is not a parameter: `robot/HOST/params/DEPLOYMENT/INSTANCE/PARAMETER`",
            ),
        ] {
            assert_eq!(says(key, text), why, "{key}");
        }
        assert_eq!(
            (robot_of("robot/c3/params/a/b/c"), robot_of("robot/c3/node/log"), robot_of("team/params/a")),
            (Some("c3"), None, None)
        );
    }

    #[test]
    fn what_the_database_says_instead_of_the_spec_is_told() {
        let mut force =
            instance("main/task/hit/force", Some(&[("threshold", Accepts::Number), ("zero", Accepts::Truth)]));
        for (status, given) in
            force.parameters.iter_mut().flatten().zip([Constant::Number(10.0), Constant::Truth(true)])
        {
            status.given = Some(given);
        }
        let says = |keys: &[(&str, &str)]| {
            let key = |(key, text): &(&str, &str)| (format!("robot/c3/params/{key}"), (*text).to_owned());
            overruled(&keys.iter().map(key).collect::<Vec<_>>(), std::slice::from_ref(&force))
        };
        assert_eq!(says(&[("door/hit/force/threshold", "10.0"), ("door/hit/force/zero", "true")]), [""; 0]);
        assert_eq!(says(&[("gate/hit/force/threshold", "12.0"), ("door/hit/threshold", "12.0")]), [""; 0]);
        let told = "`robot/c3/params/door/hit/force/threshold` is 12.0 in the database, the spec says 10; \
                    `dca param unset door:task/hit/force threshold` removes it";
        assert_eq!(says(&[("door/hit/force/threshold", "12.0"), ("door/force/threshold", "10.0")]), [told]);
        assert_eq!(says(&[("door/force/zero", "false")]).len(), 1);
    }

    #[test]
    fn a_quantity_of_another_kind_is_refused_and_one_of_its_own_becomes_si() {
        let threshold = Accepts::Quantity { of: "Force".into(), low: Some(0.0), high: Some(200.0) };
        let mut known = [instance("main/hit/force", Some(&[("threshold", threshold), ("gain", Accepts::Number)]))];
        let says = |text: &str| check("robot/c3/params/door/hit/force/threshold", text, &known);
        for text in ["12.0", "12 N", "0.012 kN"] {
            assert_eq!(says(text), Verdict::Fits, "{text}");
        }
        let why =
            "`threshold` cannot be `20 m`: expected a Force from 0 to 200 N, not a Length; write it in `N` or `kN`";
        assert_eq!(says("20 m"), Verdict::Refused(why.to_owned()));
        let declared: Vec<Parameter> =
            known[0].parameters.iter().flatten().map(|status| status.parameter.clone()).collect();
        let of = |all: &[(&str, &str)]| -> Vec<(String, String)> {
            all.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect()
        };
        let stored = of(&[("gain", "2 N"), ("threshold", "0.012 kN"), ("threshold", "20 m"), ("other", "1 N")]);
        let read = of(&[("gain", "2 N"), ("threshold", "12"), ("threshold", "20 m"), ("other", "1 N")]);
        assert_eq!(in_si(&declared, stored), read);
        for status in known[0].parameters.iter_mut().flatten() {
            status.given = Some(Constant::Number(12.0));
        }
        let overruled =
            |text: &str| overruled(&[("robot/c3/params/door/hit/force/threshold".to_owned(), text.to_owned())], &known);
        assert_eq!(overruled("0.012 kN"), [""; 0]);
        assert!(
            overruled("13 N")[0].contains("is 13 N in the database, the spec says 12 N;"),
            "{:?}",
            overruled("13 N")
        );
    }

    #[test]
    fn what_a_plan_gives_is_found_by_place_and_by_name() {
        let parameters: Vec<Parameter> =
            ["a", "b", "c"].map(|name| Parameter { name: name.into(), accepts: Accepts::Number }).into();
        let argument =
            |name: Option<&str>, value| Argument { name: name.map(str::to_owned), value: Constant::Number(value) };
        let found = given(&parameters, &[argument(Some("c"), 3.0), argument(None, 1.0)]);
        let found: Vec<Option<Constant>> = found.into_iter().map(|status| status.given).collect();
        assert_eq!(found, [Some(Constant::Number(1.0)), None, Some(Constant::Number(3.0))]);
    }
}
