//! Compares the parameters of a spec with the databases of its robots before the spec runs. Reports
//! which values replace values of the spec.

use crate::client::{Client, words};
use crate::db::databases::Databases;
use crate::follow::Spec;
use anyhow::anyhow;
use language::plan::{LeafKind, Parameter, Plan};
use node::console::{self, Failure};
use node::logic::database::settings::spelt;
use node::logic::parameters::{self, Verdict};
use node::logic::protocol::{Deployment, InstanceParameters};
use std::collections::BTreeMap;

/// The parameters of each module, according to the interfaces of programs; nothing if no program declares the module.
type Declared = BTreeMap<String, Option<Vec<Parameter>>>;

/// Refuses a spec if the database of a robot has parameters that the programs of the spec do not accept. A key may have
/// been misspelt while no program ran. It would have no effect, and no user would notice.
pub(crate) async fn check(client: &Client, spec: &Spec) -> Result<(), Failure> {
    let declared = language::parameters(&spec.modules);
    let name = &spec.plan.name;
    let mut refused = Vec::new();
    for host in &spec.plan.hosts {
        let databases = Databases::through(client, host.clone());
        let keys = match databases.parameters_of(host, &format!("{name}/")).await {
            Ok(keys) => keys,
            Err(failure) => {
                let why = words(&failure);
                console::note(&format!(
                    "warning: the parameters for `{name}` in the database of `{host}` are not known: {why}"
                ));
                continue;
            }
        };
        let known = known(&spec.plan, host, &declared);
        let spelled: Vec<(String, String)> = keys.iter().map(|(key, datum)| (key.clone(), spelt(datum))).collect();
        let overruled = parameters::overruled(&spelled, &known);
        overruled.iter().for_each(|sentence| console::note(&format!("note: {sentence}")));
        for (key, datum) in keys {
            if let Verdict::Refused(why) = parameters::check(&key, &spelt(&datum), &known) {
                refused.push(format!("{why} (`dca db delete {key}` removes the value)"));
            }
        }
    }
    if refused.is_empty() {
        return Ok(());
    }
    Err(anyhow!(
        "`{name}` was not started: the database has values that its parameters do not accept: {}",
        refused.join("; ")
    )
    .into())
}

/// Returns the programs of a plan on a host, in the form in which the host's node would report them.
fn known(plan: &Plan, host: &str, declared: &Declared) -> Vec<InstanceParameters> {
    let here = |leaf: &&language::plan::Leaf| plan.hosts.get(leaf.host as usize).is_some_and(|name| name == host);
    let deployment = Deployment { name: plan.name.clone(), epoch: 0 };
    let leaves = plan.leaves.iter().filter(here).map(|leaf| {
        let declared = match leaf.kind {
            LeafKind::Controller => declared.get(&leaf.module).and_then(Option::as_deref),
            // The parameters of a plain program cannot be changed while it runs.
            LeafKind::Plain => Some(&[][..]),
        };
        let parameters = declared.map(|declared| parameters::given(declared, &leaf.arguments));
        let (path, module) = (leaf.path.clone(), leaf.module.clone());
        InstanceParameters { deployment: deployment.clone(), path, module, parameters, ros_node: None }
    });
    leaves.collect()
}
