//! Receives the calls of command lines. Calls that need no agent are answered at once. The others are passed on to the agent.

use super::Arrival;
use crate::io::caller::{Answers, answers};
use crate::io::{calendar, team_calls};
use crate::logic::protocol::{Answer, Request, SILENCE_MAX};
use comms::io::clock;
use comms::io::session::{self, Server, Session};
use comms::logic::codec;
use std::sync::Arc;
use team::member::Member;
use tokio::sync::mpsc::Sender;
use tokio::task::JoinSet;

pub(super) async fn hear(mut calls: Server, session: Arc<Session>, member: Option<Arc<Member>>, sink: Sender<Arrival>) {
    // A killed node may have left calls that still wait, so no number of an earlier run is used again.
    let (mut number, mut answering) = (clock::now().nanos(), JoinSet::new());
    while let Some(request) = calls.next().await {
        while answering.try_join_next().is_some() {}
        number += 1;
        match codec::decode::<Request>(request.payload()) {
            Ok(Request::Clock) => at_once(request, &Answer::Clock(calendar::read())).await,
            Ok(Request::Team) => at_once(request, &Answer::Team(member.as_deref().map(team_calls::team))).await,
            Ok(Request::Credentials) => {
                let known = member.as_ref().map_or_else(Vec::new, |member| member.known_credentials());
                at_once(request, &Answer::Credentials(known)).await;
            }
            Ok(Request::Unlinked) => at_once(request, &Answer::Unlinked(session.unlinked())).await,
            Ok(Request::Revoke { set }) => at_once(request, &team_calls::revoke(member.as_deref(), &set)).await,
            Ok(Request::Revocations(told)) => {
                at_once(request, &team_calls::revocations(member.as_deref(), &told)).await;
            }
            Ok(Request::RenewUser { ask }) => at_once(request, &team_calls::renew_user(member.as_deref(), &ask)).await,
            Ok(asked) => {
                let (caller, to_send) = answers();
                answering.spawn(reply(request, to_send));
                if sink.send(Arrival::Call(number, asked, caller)).await.is_err() {
                    return;
                }
            }
            Err(error) => request.refuse(&format!("the request cannot be read: {error}")),
        }
    }
}

async fn at_once(mut request: session::Request, answer: &Answer) {
    match codec::encode(answer) {
        Ok(bytes) => {
            request.reply(bytes).await;
            request.finish();
        }
        Err(error) => request.refuse(&format!("the answer cannot be written: {error}")),
    }
}

/// Passes answers on. During pauses, says that further answers may come. At the end, says whether the answers are complete.
async fn reply(mut request: session::Request, mut answers: Answers) {
    let mut pause = tokio::time::interval(SILENCE_MAX / 4);
    pause.reset();
    loop {
        tokio::select! {
            answer = answers.next() => match answer.map(|answer| codec::encode(&answer)) {
                Some(Ok(bytes)) => {
                    if !request.reply(bytes).await {
                        return;
                    }
                }
                Some(Err(error)) => return request.refuse(&format!("the answer cannot be written: {error}")),
                None => return match answers.end() {
                    Ok(()) => request.finish(),
                    Err(why) => request.break_off(&why),
                },
            },
            _ = pause.tick() => request.still_here(),
            () = request.left() => return,
        }
    }
}
