use super::*;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::io::AsyncWriteExt as _;
use trust::invite::OpenInvite;
use trust::name::UnixTime;
use trust::role::Role;
use zeroize::Zeroizing;

/// An inviter that waits on a port of this machine for a robot called `r1`.
struct Waiting {
    line: String,
    at: SocketAddr,
    kept: Arc<AtomicUsize>,
    events: mpsc::Receiver<Event>,
    _tasks: JoinSet<()>,
}

async fn waiting(seconds: u64) -> Waiting {
    waiting_with(seconds, true).await
}

/// Returns an inviter whose disk stores certificates if `takes`.
async fn waiting_with(seconds: u64, takes: bool) -> Waiting {
    let root = SecretKeys::generate(&mut crate::random().unwrap());
    let team = Team::found("acme".parse().unwrap(), &root);
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let at = listener.local_addr().unwrap();
    let expires = UnixTime(crate::now().0 + seconds);
    let secret = Zeroizing::new(entropy::bytes().unwrap());
    let invite = Invite { team: team.id(), secret, expires, addresses: vec![at], founds: false };
    let mut inviter = Inviter::new(team, root, None);
    let open = OpenInvite { expires, role: Role::Member, name: Some("r1".parse().unwrap()) };
    inviter.open(invite.hash(), open, crate::now()).unwrap();
    let (events_tx, events) = mpsc::channel(64);
    let kept = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&kept);
    let keep = move |_: &Certificate| {
        ensure!(takes, "no space");
        count.fetch_add(1, Ordering::SeqCst);
        Ok(())
    };
    let mut tasks = JoinSet::new();
    tasks.spawn(super::invite(vec![listener], inviter, keep, events_tx));
    Waiting { line: invite.to_line().to_string(), at, kept, events, _tasks: tasks }
}

fn keys() -> SecretKeys {
    SecretKeys::generate(&mut crate::random().unwrap())
}

#[tokio::test]
async fn one_joins_and_no_other() {
    let mut waiting = waiting(60).await;
    let name: Name = "robot".parse().unwrap();
    let (_, team, credential) = join(&waiting.line, name.clone(), keys()).await.unwrap();
    let claims = credential.certificate().claims();
    assert_eq!((claims.name.as_str(), team.name().as_str()), ("r1", "acme"), "the inviter says the name");
    assert!(matches!(waiting.events.recv().await, Some(Event::Joined(given)) if *given == *credential.certificate()));
    let again = join(&waiting.line, name, keys()).await.unwrap_err();
    assert_eq!(again.to_string(), JoinError::Refused.to_string());
    assert!(matches!(waiting.events.recv().await, Some(Event::Refused(..))));
    assert_eq!(waiting.kept.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn nobody_joins_whose_certificate_cannot_be_kept() {
    let mut waiting = waiting_with(60, false).await;
    let refused = join(&waiting.line, "robot".parse().unwrap(), keys()).await.unwrap_err();
    assert_eq!(refused.to_string(), JoinError::Refused.to_string());
    let Some(Event::Failed(why)) = waiting.events.recv().await else { panic!("the inviter has not heard of it") };
    assert_eq!(why, "cannot store the certificate: no space");
}

/// Clients that send nonsense, or nothing, do not prevent a robot from joining.
#[tokio::test]
async fn others_do_not_disturb() {
    let waiting = waiting(60).await;
    let mut silent = Vec::new();
    for number in 0..100 {
        let mut stream = TcpStream::connect(waiting.at).await.unwrap();
        if number % 2 == 0 {
            stream.write_all(&[0xff; 100]).await.unwrap();
        }
        silent.push(stream);
    }
    let joined = join(&waiting.line, "robot".parse().unwrap(), keys()).await;
    assert_eq!(joined.unwrap().2.certificate().claims().name.as_str(), "r1");
    assert_eq!(waiting.kept.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn an_invitation_is_for_its_team_alone() {
    let (one, other) = (waiting(60).await, waiting(60).await);
    let mut line = Invite::from_line(&one.line).unwrap();
    line.addresses = vec![other.at];
    let refused = join(&line.to_line(), "robot".parse().unwrap(), keys()).await.unwrap_err();
    assert_eq!(refused.to_string(), JoinError::OtherTeam.to_string());
    assert_eq!(other.kept.load(Ordering::SeqCst), 0);
}

/// Repeated wrong lines neither exclude the right one nor make it wait.
#[tokio::test]
async fn the_right_line_does_not_wait_for_wrong_ones() {
    let waiting = waiting(60).await;
    let mut wrong = Invite::from_line(&waiting.line).unwrap();
    wrong.secret = Zeroizing::new([7; 16]);
    let wrong = wrong.to_line().to_string();
    let mut trying = JoinSet::new();
    for _ in 0..40 {
        let line = wrong.clone();
        trying.spawn(async move { join(&line, "robot".parse().unwrap(), keys()).await.unwrap_err().to_string() });
    }
    // Some were refused, and the others still wait.
    assert_eq!(trying.join_next().await.unwrap().unwrap(), JoinError::Refused.to_string());
    let joined = join(&waiting.line, "robot".parse().unwrap(), keys()).await;
    assert_eq!(joined.unwrap().2.certificate().claims().name.as_str(), "r1");
    assert_eq!(waiting.kept.load(Ordering::SeqCst), 1);
}
