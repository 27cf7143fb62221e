//! The exports of a controller: procedures that others call and states that others read, between two calculations of
//! its loop.

use super::port::{Message, is_fit};
use comms::logic::object::{Access, ExportKind, Exported, ObjectCall, ObjectError, Signature, TypeForm};
use std::fmt;
use std::marker::PhantomData;

/// The exports of a controller type, in order of declaration: see [`super::Controller::exports`].
pub struct Exports<C> {
    all: Vec<Export<C>>,
}

struct Export<C> {
    about: ExportInterface,
    run: Run<C>,
}

/// How an export is executed, from the encoded argument.
enum Run<C> {
    Procedure(Box<RunProcedure<C>>),
    State(Box<ReadState<C>>),
}

type RunProcedure<C> = dyn Fn(&mut C, &[u8], RawReply) + Send;
type ReadState<C> = dyn Fn(&C) -> Result<Vec<u8>, ObjectError> + Send;

/// The static description of an export.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportInterface {
    /// `Grip`, `opening`
    pub name: &'static str,
    /// Procedure or state.
    pub kind: ExportKind,
    /// The types of argument and result.
    pub signature: Signature,
    /// One sentence.
    pub doc: &'static str,
    /// Whether the export also answers while the process is idle.
    pub is_answered_idle: bool,
    /// The right that a user of a team needs.
    pub access: Access,
}

/// The static description of a call that a controller makes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CallInterface {
    /// Its name: `Grip`.
    pub name: &'static str,
    /// The types of argument and result.
    pub signature: Signature,
    /// One sentence.
    pub doc: &'static str,
    /// Whether the controller cannot work if the call is not connected.
    pub required: bool,
}

/// Whether the loop of a controller runs an activation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    /// The loop runs an activation.
    Running,
    /// The loop waits for an activation.
    Idle,
    /// The loop ends an activation.
    Stopping,
}

/// Takes the result of a call, encoded.
type Take = Box<dyn FnOnce(Result<Vec<u8>, ObjectError>) + Send>;

/// The path of the answer to one call, for any type. If it is dropped without an answer, the caller receives `Gone`.
pub struct RawReply {
    take: Take,
    is_wanted: Box<dyn Fn() -> bool + Send>,
}

/// The path of the answer to one call. A controller may keep it and answer in a later calculation. If it is dropped
/// without an answer, the caller receives `Gone`.
#[derive(Debug)]
pub struct Reply<R> {
    raw: RawReply,
    of: PhantomData<fn(R)>,
}

impl<C> Default for Exports<C> {
    fn default() -> Self {
        Self { all: Vec::new() }
    }
}

impl<C> fmt::Debug for Exports<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.all.iter().map(|export| &export.about)).finish()
    }
}

impl<C: 'static> Exports<C> {
    /// Exports a procedure that is answered at once. Its error is a reason for the caller, in one line.
    pub fn procedure<A: Message, R: Message>(
        &mut self,
        name: &'static str,
        doc: &'static str,
        run: fn(&mut C, A) -> Result<R, String>,
    ) -> &mut Self {
        self.add::<A, R>(name, doc, move |controller, argument, reply: Reply<R>| match run(controller, argument) {
            Ok(result) => reply.send(result),
            Err(reason) => reply.refuse(reason),
        })
    }

    /// Exports a procedure that takes some time: the controller keeps the [`Reply`] and answers in a later calculation.
    pub fn procedure_later<A: Message, R: Message>(
        &mut self,
        name: &'static str,
        doc: &'static str,
        run: fn(&mut C, A, Reply<R>),
    ) -> &mut Self {
        self.add::<A, R>(name, doc, run)
    }

    /// Exports a state. It is read between two calculations, and also while the process is idle.
    pub fn state<R: Message>(&mut self, name: &'static str, doc: &'static str, read: fn(&C) -> R) -> &mut Self {
        let about = ExportInterface {
            name,
            kind: ExportKind::State,
            signature: Signature { argument: TypeForm::default(), result: form::<R>() },
            doc,
            is_answered_idle: true,
            access: Access::Look,
        };
        let run = Run::State(Box::new(move |controller| encode(&read(controller))));
        self.all.push(Export { about, run });
        self
    }

    /// Lets the last exported procedure also answer while the process is idle.
    pub fn idle(&mut self) -> &mut Self {
        self.all.iter_mut().last().into_iter().for_each(|export| export.about.is_answered_idle = true);
        self
    }

    /// Sets the right that a user of a team needs to call the procedure that was exported last. Without this call it is
    /// [`Access::Operate`]. A procedure that changes nothing should have [`Access::Look`].
    pub fn access(&mut self, access: Access) -> &mut Self {
        self.all.iter_mut().last().into_iter().for_each(|export| export.about.access = access);
        self
    }

    fn add<A: Message, R: Message>(
        &mut self,
        name: &'static str,
        doc: &'static str,
        run: impl Fn(&mut C, A, Reply<R>) + Send + 'static,
    ) -> &mut Self {
        let about = ExportInterface {
            name,
            kind: ExportKind::Procedure,
            signature: Signature { argument: form::<A>(), result: form::<R>() },
            doc,
            is_answered_idle: false,
            access: Access::default(),
        };
        let run = move |controller: &mut C, argument: &[u8], raw: RawReply| {
            let read = postcard::from_bytes(argument);
            let read =
                read.map_err(|cause| refused(format!("the argument is not a value of type `{}`: {cause}", A::TYPE)));
            match read.and_then(|argument| fit(&argument, "argument").map(|()| argument)) {
                Ok(argument) => run(controller, argument, Reply { raw, of: PhantomData }),
                Err(error) => raw.answer(Err(error)),
            }
        };
        self.all.push(Export { about, run: Run::Procedure(Box::new(run)) });
        self
    }

    /// Returns the static descriptions of the exports.
    pub fn interfaces(&self) -> Vec<ExportInterface> {
        self.all.iter().map(|export| export.about.clone()).collect()
    }

    /// Executes a call.
    pub fn serve(&self, controller: &mut C, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        let Some(export) = self.all.iter().find(|export| export.about.name == name) else {
            return reply.answer(Err(unknown(name, &self.interfaces())));
        };
        match &export.run {
            Run::State(read) => reply.answer(read(controller)),
            Run::Procedure(run) if activity == Activity::Running || export.about.is_answered_idle => {
                run(controller, argument, reply);
            }
            Run::Procedure(_) => {
                let does = if activity == Activity::Idle { "does not run" } else { "is stopping" };
                reply.answer(Err(refused(format!("`{name}` cannot answer now: its process {does}"))));
            }
        }
    }
}

/// Returns the right that a user needs for a call, if the call fits an export.
///
/// # Errors
/// If there is no such export, or the caller expects other types.
pub(super) fn admit(exports: &[ExportInterface], call: &ObjectCall) -> Result<Access, ObjectError> {
    let export = exports.iter().find(|export| export.name == call.name);
    let export = export.ok_or_else(|| unknown(&call.name, exports))?;
    if export.signature.fits(&call.signature) {
        return Ok(export.access);
    }
    let (theirs, ours) = (Box::new(export.signature.clone()), Box::new(call.signature.clone()));
    Err(ObjectError::WrongType { name: call.name.clone(), theirs, ours })
}

fn unknown(name: &str, exports: &[ExportInterface]) -> ObjectError {
    let known = exports.iter().map(|export| export.name.to_owned()).collect();
    ObjectError::NoSuchProcedure { name: name.to_owned(), known }
}

pub(super) fn refused(reason: String) -> ObjectError {
    ObjectError::Refused { reason }
}

/// Returns the description of a message type.
pub(super) fn form<T: Message>() -> TypeForm {
    TypeForm::new(T::TYPE, T::FIELDS)
}

/// Checks whether a value may be the argument or the result of a call. `what` is the word for it in the error.
///
/// # Errors
/// If a number in the value is not finite.
pub(super) fn fit<T: Message>(value: &T, what: &str) -> Result<(), ObjectError> {
    if is_fit(value) { Ok(()) } else { Err(refused(format!("a number of the {what} is not finite"))) }
}

pub(super) fn encode<T: Message>(value: &T) -> Result<Vec<u8>, ObjectError> {
    postcard::to_stdvec(value).map_err(|cause| refused(format!("cannot encode a value of type `{}`: {cause}", T::TYPE)))
}

impl ExportInterface {
    /// Returns the description of the export in its encoded form.
    pub fn exported(&self) -> Exported {
        Exported {
            name: self.name.to_owned(),
            kind: self.kind,
            signature: self.signature.clone(),
            doc: self.doc.trim().to_owned(),
            is_answered_idle: self.is_answered_idle,
            access: self.access,
        }
    }

    /// Returns for example `proc Grip(Push) -> Width idle;` or `state opening: Width;`.
    pub(super) fn text(&self) -> String {
        match self.kind {
            ExportKind::State => format!("state {}: {};", self.name, self.signature.result.name),
            ExportKind::Procedure => {
                let idle = if self.is_answered_idle { " idle" } else { "" };
                format!("proc {}{idle};", called(self.name, &self.signature))
            }
        }
    }
}

impl CallInterface {
    /// Returns the description of the call `name`.
    pub fn new<A: Message, R: Message>(name: &'static str, doc: &'static str, required: bool) -> Self {
        Self { name, signature: Signature { argument: form::<A>(), result: form::<R>() }, doc, required }
    }

    /// Returns for example `calls Grip(Push) -> Width optional;`.
    pub(super) fn text(&self) -> String {
        let optional = if self.required { "" } else { " optional" };
        format!("calls {}{optional};", called(self.name, &self.signature))
    }
}

/// Returns for example `Grip(Push) -> Width`.
fn called(name: &str, signature: &Signature) -> String {
    let answers =
        if signature.result.name.is_empty() { String::new() } else { format!(" -> {}", signature.result.name) };
    format!("{name}({}){answers}", signature.argument.name)
}

impl RawReply {
    /// Returns the path of an answer. `is_wanted` returns whether the caller still waits for the answer.
    pub fn new(
        take: impl FnOnce(Result<Vec<u8>, ObjectError>) + Send + 'static,
        is_wanted: impl Fn() -> bool + Send + 'static,
    ) -> Self {
        Self { take: Box::new(take), is_wanted: Box::new(is_wanted) }
    }

    /// Returns whether the caller still waits for the answer.
    pub fn is_wanted(&self) -> bool {
        (self.is_wanted)()
    }

    /// Sends the answer.
    pub fn answer(self, result: Result<Vec<u8>, ObjectError>) {
        (self.take)(result);
    }
}

impl fmt::Debug for RawReply {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RawReply").finish_non_exhaustive()
    }
}

impl<R: Message> Reply<R> {
    /// Sends the answer.
    pub fn send(self, result: R) {
        self.raw.answer(encode(&result));
    }

    /// Answers that the call was not executed, with the reason in one line.
    pub fn refuse(self, reason: impl Into<String>) {
        self.raw.answer(Err(refused(reason.into())));
    }

    /// Returns whether the caller still waits: it has not cancelled, its time limit has not passed, and its program
    /// lives.
    pub fn is_wanted(&self) -> bool {
        self.raw.is_wanted()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::bytes::Bytes;
    use comms::logic::object::CallId;
    use serde::{Deserialize, Serialize};
    use std::sync::mpsc::{Receiver, sync_channel};
    use std::time::Duration;

    #[derive(Clone, Copy, Debug, Serialize, Deserialize)]
    struct Width(f64);
    impl Message for Width {
        const TYPE: &'static str = "Width";
        const FIELDS: &'static str = "length: Length";
    }

    /// The fingers, and the caller that waits for them.
    #[derive(Default)]
    struct Hand {
        width: f64,
        waiting: Option<Reply<Width>>,
    }

    fn exports() -> Exports<Hand> {
        let mut exports = Exports::default();
        exports
            .procedure("Open", "Opens.", |hand: &mut Hand, width: Width| {
                if width.0 > 1.0 {
                    return Err("too wide".to_owned());
                }
                hand.width = width.0;
                Ok(())
            })
            .procedure("Home", "Goes home.", |hand: &mut Hand, ()| Ok(Width(hand.width)))
            .idle()
            .access(Access::Look)
            .procedure_later("Grip", "", |hand: &mut Hand, (), reply| hand.waiting = Some(reply))
            .state("opening", "How far it is open.", |hand| Width(hand.width));
        exports
    }

    type Answer = Result<Vec<u8>, ObjectError>;

    fn serve(hand: &mut Hand, name: &str, argument: &[u8], activity: Activity) -> Receiver<Answer> {
        let (answer_tx, answer) = sync_channel(1);
        let reply = RawReply::new(move |result| answer_tx.send(result).unwrap(), || true);
        exports().serve(hand, name, argument, activity, reply);
        answer
    }

    #[test]
    fn each_call_is_answered_by_its_export() {
        let mut hand = Hand::default();
        let mut ask = |name, argument: &[u8], activity| serve(&mut hand, name, argument, activity).try_recv().unwrap();
        let (half, two) = (0.5_f64.to_le_bytes(), 2_f64.to_le_bytes());
        let refused = |answer: Answer| answer.unwrap_err().to_string();
        assert_eq!(ask("Open", &half, Activity::Running), Ok(vec![]));
        assert_eq!(refused(ask("Open", &two, Activity::Running)), "too wide");
        assert!(
            refused(ask("Open", &two[1..], Activity::Running))
                .starts_with("the argument is not a value of type `Width`")
        );
        assert_eq!(refused(ask("Open", &half, Activity::Idle)), "`Open` cannot answer now: its process does not run");
        assert_eq!(
            refused(ask("Open", &half, Activity::Stopping)),
            "`Open` cannot answer now: its process is stopping"
        );
        for activity in [Activity::Running, Activity::Idle, Activity::Stopping] {
            assert_eq!(ask("Home", &[], activity), Ok(half.to_vec()));
            assert_eq!(ask("opening", &[], activity), Ok(half.to_vec()));
        }
        assert_eq!(
            refused(ask("Close", &[], Activity::Running)),
            "it exports no `Close`; its exports are `Open`, `Home`, `Grip`, `opening`"
        );
    }

    #[test]
    fn an_answer_may_come_later_or_never() {
        let mut hand = Hand::default();
        let answer = serve(&mut hand, "Grip", &[], Activity::Running);
        assert!(answer.try_recv().is_err());
        let reply = hand.waiting.take().unwrap();
        assert!(reply.is_wanted());
        reply.send(Width(1.0));
        assert_eq!(answer.try_recv(), Ok(Ok(1_f64.to_le_bytes().to_vec())));
        let dropped = serve(&mut hand, "Grip", &[], Activity::Running);
        hand.waiting = None;
        assert!(dropped.recv().is_err(), "nobody gives an answer any more");
    }

    #[test]
    fn who_knows_other_types_is_not_let_in() {
        let call = |name: &str, argument: TypeForm| ObjectCall {
            id: CallId { session: "a".into(), number: 1 },
            caller: "b".into(),
            name: name.into(),
            signature: Signature { argument, result: TypeForm::default() },
            within: Duration::from_secs(1),
            argument: Bytes::default(),
            warrant: None,
        };
        let interfaces = exports().interfaces();
        let admitted = |name, argument| admit(&interfaces, &call(name, argument));
        assert_eq!(admitted("Open", form::<Width>()), Ok(Access::Operate));
        assert_eq!(admitted("Open", TypeForm::new("Width", "")), Ok(Access::Operate));
        let home = Signature { argument: TypeForm::default(), result: form::<Width>() };
        let home = ObjectCall { signature: home, ..call("Home", TypeForm::default()) };
        assert_eq!(admit(&interfaces, &home), Ok(Access::Look), "it says so");
        assert_eq!(interfaces.iter().map(|one| one.access).collect::<Vec<_>>()[2..], [Access::Operate, Access::Look]);
        assert!(matches!(admitted("Open", TypeForm::default()), Err(ObjectError::WrongType { .. })));
        assert!(matches!(admitted("Open", TypeForm::new("Width", "angle: Angle")), Err(ObjectError::WrongType { .. })));
        assert!(matches!(admitted("Nope", TypeForm::default()), Err(ObjectError::NoSuchProcedure { .. })));
        let texts: Vec<String> = interfaces.iter().map(ExportInterface::text).collect();
        assert_eq!(
            texts,
            ["proc Open(Width);", "proc Home() -> Width idle;", "proc Grip() -> Width;", "state opening: Width;"]
        );
        let calls = CallInterface::new::<Width, ()>("Open", "", false);
        assert_eq!(calls.text(), "calls Open(Width) optional;");
    }
}
