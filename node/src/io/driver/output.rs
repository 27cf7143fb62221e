//! Answers calls with the output of programs.

use super::Driver;
use crate::io::caller::Caller;
use crate::io::tail;
use crate::logic::protocol::Deployment;

impl Driver {
    /// Answers a call with output, in a task that ends when the deployment is over here.
    pub(super) fn tail<T: Future<Output = ()> + Send + 'static>(
        &mut self,
        call: u64,
        deployment: &Deployment,
        reading: impl FnOnce(Caller, tail::DeploymentEnd) -> T,
    ) {
        let Some(caller) = self.peers.take(call) else { return };
        let over = tail::DeploymentEnd::new(self.running.living.get(deployment));
        self.queues.tasks.spawn(reading(caller, over));
    }
}
