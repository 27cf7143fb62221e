//! The standard messages and services of ROS 2, and some actions, as data.
//!
//! `ros/generate/messages.py` wrote the messages. A definition is only parsed when it is used.

use super::definition::DefinitionError;
use super::name::{Folder, TypeName, spec_package, spec_words};
use super::schema::{Schema, sections};
use std::borrow::Cow;

/// For each package, its name and its definitions.
const PACKAGES: [(&str, &str); 16] = [
    ("action_msgs", include_str!("../../messages/action_msgs.msgs")),
    ("builtin_interfaces", include_str!("../../messages/builtin_interfaces.msgs")),
    ("diagnostic_msgs", include_str!("../../messages/diagnostic_msgs.msgs")),
    ("geometry_msgs", include_str!("../../messages/geometry_msgs.msgs")),
    ("lifecycle_msgs", include_str!("../../messages/lifecycle_msgs.msgs")),
    ("nav_msgs", include_str!("../../messages/nav_msgs.msgs")),
    ("rcl_interfaces", include_str!("../../messages/rcl_interfaces.msgs")),
    ("rosgraph_msgs", include_str!("../../messages/rosgraph_msgs.msgs")),
    ("sensor_msgs", include_str!("../../messages/sensor_msgs.msgs")),
    ("service_msgs", include_str!("../../messages/service_msgs.msgs")),
    ("shape_msgs", include_str!("../../messages/shape_msgs.msgs")),
    ("std_msgs", include_str!("../../messages/std_msgs.msgs")),
    ("tf2_msgs", include_str!("../../messages/tf2_msgs.msgs")),
    ("trajectory_msgs", include_str!("../../messages/trajectory_msgs.msgs")),
    ("unique_identifier_msgs", include_str!("../../messages/unique_identifier_msgs.msgs")),
    ("visualization_msgs", include_str!("../../messages/visualization_msgs.msgs")),
];
/// The definitions of services.
const SERVICES: &str = include_str!("../../messages/services.srvs");
/// The definitions of actions.
const ACTIONS: &str = include_str!("../../messages/actions.actions");
/// The line between the parts of a service or an action.
const MIDDLE: &str = "---";

/// Returns the names of all standard messages, in the order of their packages.
pub fn messages() -> impl Iterator<Item = TypeName> {
    PACKAGES.iter().flat_map(|(_, text)| sections(text)).map(|(name, _)| name)
}

/// Returns the names of all standard services.
pub fn services() -> impl Iterator<Item = TypeName> {
    let names = sections(SERVICES).map(|(name, _)| TypeName::new(name.package(), Folder::Srv, name.name()));
    names.flatten()
}

/// Returns the names of all known actions.
pub fn actions() -> impl Iterator<Item = TypeName> {
    let names = sections(ACTIONS).map(|(name, _)| TypeName::new(name.package(), Folder::Action, name.name()));
    names.flatten()
}

/// Returns the types that programs use as parts: requests and responses of services, and goals, results and feedback of
/// actions.
pub fn parts() -> impl Iterator<Item = TypeName> {
    let of_services = services().flat_map(|service| [service.request(), service.response()]);
    let of_actions = actions().flat_map(|action| ["_Goal", "_Result", "_Feedback"].map(|ending| action.with(ending)));
    of_services.chain(of_actions)
}

/// Returns the standard type with this name in specs: a message, a service or an action, or a part of one, such as
/// `ros.sensor.LaserScan` or `ros.std_srvs.Trigger_Request`.
pub fn by_spec(text: &str) -> Option<TypeName> {
    let (package, name) = spec_words(text)?;
    let is_meant = |found: &TypeName| spec_package(found.package()) == package && found.name() == name;
    let own = PACKAGES.iter().filter(|(name, _)| spec_package(name) == package);
    let messages = own.flat_map(|(_, text)| sections(text)).map(|(name, _)| name);
    messages.chain(services()).chain(actions()).chain(parts()).find(is_meant)
}

/// Returns the standard service with this request and response, by their names in specs: `ros.std_srvs.Trigger_Request`
/// and
/// `ros.std_srvs.Trigger_Response`.
pub fn service_of(request: &str, response: &str) -> Option<TypeName> {
    let request = by_spec(request)?;
    let service = services().find(|service| service.request() == request)?;
    (service.response().spec() == response).then_some(service)
}

/// Returns the schema of a standard message, of a standard service, or of a part of a service or an action:
/// `std_srvs/srv/Trigger_Request`, `example_interfaces/action/Fibonacci_SendGoal`.
///
/// # Errors
/// If the library does not contain the type.
pub fn schema(name: &TypeName) -> Result<Schema, DefinitionError> {
    Schema::new(name, definition)
}

/// Returns the lines that define a standard type.
fn definition(name: &TypeName) -> Option<Cow<'static, str>> {
    match name.folder() {
        Folder::Msg => {
            let (_, text) = PACKAGES.iter().find(|(package, _)| *package == name.package())?;
            let found = sections(text).find(|(other, _)| other == name);
            found.map(|(_, lines)| Cow::Borrowed(lines))
        }
        Folder::Srv => service(name),
        Folder::Action => action(name),
    }
}

/// Returns the lines that define a part of an action. Source: `rosidl_parser`, `Action`.
fn action(name: &TypeName) -> Option<Cow<'static, str>> {
    let (base, part) = name.name().split_once('_')?;
    let (_, lines) = sections(ACTIONS).find(|(one, _)| one.package() == name.package() && one.name() == base)?;
    let (goal, rest) = halves(lines)?;
    let (result, feedback) = halves(rest)?;
    let whole = TypeName::new(name.package(), Folder::Action, base)?;
    let part_of = |ending: &str| whole.with(ending);
    let id = "unique_identifier_msgs/UUID goal_id\n";
    Some(match part {
        "Goal" => Cow::Borrowed(goal),
        "Result" => Cow::Borrowed(result),
        "Feedback" => Cow::Borrowed(feedback),
        "SendGoal_Request" => Cow::Owned(format!("{id}{} goal\n", part_of("_Goal"))),
        "SendGoal_Response" => Cow::Borrowed("bool accepted\nbuiltin_interfaces/Time stamp\n"),
        "GetResult_Request" => Cow::Borrowed(id),
        "GetResult_Response" => Cow::Owned(format!("int8 status\n{} result\n", part_of("_Result"))),
        "FeedbackMessage" => Cow::Owned(format!("{id}{} feedback\n", part_of("_Feedback"))),
        "SendGoal" | "GetResult" => Cow::Owned(parts_of(name)),
        "SendGoal_Event" => Cow::Owned(event_of(&part_of("_SendGoal"))),
        "GetResult_Event" => Cow::Owned(event_of(&part_of("_GetResult"))),
        _ => return None,
    })
}

/// Returns the lines that define a service as a whole.
fn parts_of(service: &TypeName) -> String {
    let (asked, answered, event) = (service.request(), service.response(), service.with("_Event"));
    format!("{asked} request_message\n{answered} response_message\n{event} event_message\n")
}

/// Returns the lines that define the event of a service.
fn event_of(service: &TypeName) -> String {
    let (asked, answered) = (service.request(), service.response());
    format!("service_msgs/ServiceEventInfo info\n{asked}[<=1] request\n{answered}[<=1] response\n")
}

/// Returns the lines that define a service, or a part of one. Source: `rosidl_parser`, `Service`.
fn service(name: &TypeName) -> Option<Cow<'static, str>> {
    let (base, part) = name.name().split_once('_').map_or((name.name(), None), |(base, part)| (base, Some(part)));
    let (_, lines) = sections(SERVICES).find(|(one, _)| one.package() == name.package() && one.name() == base)?;
    let (request, response) = halves(lines)?;
    let whole = TypeName::new(name.package(), Folder::Srv, base)?;
    Some(match part {
        Some("Request") => Cow::Borrowed(request),
        Some("Response") => Cow::Borrowed(response),
        Some("Event") => Cow::Owned(event_of(&whole)),
        Some(_) => return None,
        None => Cow::Owned(parts_of(&whole)),
    })
}

/// Returns the lines before the first separator of parts, and the lines after it.
fn halves(lines: &str) -> Option<(&str, &str)> {
    let at = lines.lines().position(|line| line == MIDDLE)?;
    let before: usize = lines.split_inclusive('\n').take(at).map(str::len).sum();
    let (request, rest) = lines.split_at(before);
    Some((request, rest.strip_prefix(MIDDLE)?.trim_start()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::hash::rihs01;

    #[test]
    fn every_type_has_a_schema_and_a_name_of_its_own() {
        let all: Vec<TypeName> = messages().chain(services()).chain(parts()).collect();
        assert!(all.len() > 150, "{}", all.len());
        for name in &all {
            let schema = schema(name).unwrap();
            assert_eq!(schema.name(), name);
            assert_eq!(by_spec(&name.spec()).as_ref(), Some(name));
            if name.folder() == Folder::Msg {
                assert_eq!(Schema::parse(name, &schema.text()), Ok(schema), "{name}");
            }
        }
        let trigger = TypeName::parse("std_srvs/srv/Trigger").unwrap();
        for name in [trigger.request(), trigger.response()] {
            assert_eq!(by_spec(&name.spec()).as_ref(), Some(&name));
            assert_eq!(schema(&name).unwrap().name(), &name);
        }
        let [request, response] = ["ros.std_srvs.Trigger_Request", "ros.std_srvs.Trigger_Response"];
        assert_eq!(service_of(request, response), Some(trigger));
        for (request, response) in
            [(request, request), (response, request), (request, "ros.std_srvs.Empty_Response"), ("", "")]
        {
            assert_eq!(service_of(request, response), None, "{request} {response}");
        }
        for text in ["ros.sensor.LaserScam", "ros.sensor_msgs.LaserScan", "ros.sensor", "sensor.LaserScan", "ros..", ""]
        {
            assert_eq!(by_spec(text), None, "{text}");
        }
    }

    /// The hashes are those of an unmodified ROS 2.
    #[test]
    fn hashes_are_those_of_ros() {
        let check = |name: &str, expected: &str| {
            let schema = schema(&TypeName::parse(name).unwrap()).unwrap();
            assert_eq!(rihs01(&schema), format!("RIHS01_{expected}"), "{name}");
        };
        check("std_msgs/String", "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18");
        check("std_msgs/Char", "3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9");
        check("std_msgs/Byte", "41e1a3345f73fe93ede006da826a6ee274af23dd4653976ff249b0f44e3e798f");
        check("std_msgs/ColorRGBA", "77a7a5b9ae477306097665106e0413ba74440245b1f3d0c6d6405fe5c7813fe8");
        check("std_srvs/srv/Trigger", "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f");
    }
}
