//! The words and operators of the language, each with its meaning, for completion and hover.
//!
//! A new word of the language needs one line here.

/// The place of a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Between the items of a file.
    Item,
    /// Between the sections of a process.
    Section,
    /// Between the items of a module.
    ModuleItem,
    /// Where an event action begins.
    Action,
    /// After an event action.
    Suffix,
    /// After a connection.
    Quality,
    /// In the braces after an instance.
    Policy,
    /// In the supervision of a group.
    Rule,
    /// An operator, which is not completed.
    Operator,
    /// Inside another construct.
    Inside,
    /// Where a sentence of a `verify` block begins.
    Sentence,
    /// Inside a sentence of a `verify` block.
    InSentence,
    /// An event or state, after the name of a process in a sentence.
    Event,
    /// In a formula.
    Formula,
}

/// A word or an operator.
#[derive(Debug)]
pub(super) struct Word {
    pub(super) place: Place,
    pub(super) text: &'static str,
    /// The text to insert. `$0` is the cursor, and `${1:name}` is a part that the user fills in.
    pub(super) snippet: &'static str,
    /// The meaning, in a sentence or two.
    pub(super) meaning: &'static str,
}

/// Returns the word or operator with this text, at the most likely place.
pub(super) fn find(text: &str, places: &[Place]) -> Option<&'static Word> {
    let text = if text == ":;" { ";;" } else { text };
    WORDS.iter().find(|word| word.text == text && places.contains(&word.place))
}

/// Returns the word of a sentence that contains this part: `can` finds `can finish`.
pub(super) fn in_sentence(text: &str) -> Option<&'static Word> {
    let exact = find(text, &[Place::Event, Place::Sentence, Place::InSentence]);
    let places = [Place::Sentence, Place::InSentence];
    let holds = |word: &&Word| places.contains(&word.place) && word.text.split(' ').any(|part| part == text);
    exact.or_else(|| WORDS.iter().find(holds))
}

/// Returns the words for a place.
pub(super) fn at(place: Place) -> impl Iterator<Item = &'static Word> {
    WORDS.iter().filter(move |word| word.place == place)
}

macro_rules! words {
    ($($place:ident $text:literal $snippet:literal $meaning:literal)*) => {
        const WORDS: &[Word] = &[$(Word { place: Place::$place, text: $text, snippet: $snippet, meaning: $meaning },)*];
    };
}

words! {
    Item "process" "process ${1:Name}(${2}){\n    instantiated_processes{\n        $0\n    }\n    internal_event_actions{\n    }\n}"
        "A process group: its instances, their connections and their order. A deployment starts with the group `main`."
    Item "module" "module ${1:Name}(host) { $0 }"
        "The interface of a controller: its ports, whether it ends, and its claims. A controller program prints its interface with \
         `--dca-interface`."
    Item "const" "const ${1:name} = $0;"
        "A named value, or a named list of values, from which an index chooses one value: `const hosts = [c1, c2];`, `hosts[0]`."
    Item "type" "type ${1:Name} = { ${2:field}: ${3:Number} };"
        "A record, or another name for a type. Values of a record are written `{ field = 1 }`."
    Item "use" "use \"$0\";"
        "The declarations of another file, or of all `.dca` files of a folder; the path is relative to this file."
    Item "verify" "verify ${1:Name} {\n    $0\n}"
        "The sentences that must hold of this process in every order of events; `dca verify` proves it."
    Section "host" "host{$0}"
        "The host of the supervisor of this group, and of each part of the group that names no host."
    Section "instantiated_processes" "instantiated_processes{\n    $0\n}"
        "The instances of the group: `name instof Type(host, argument);`."
    Section "external_io" "external_io{\n    $0\n}"
        "The ports that the group shows to the outside: `Out = instance, Port;`."
    Section "internal_connections" "internal_connections(${1:owner}, ${2:label}){\n    $0\n}"
        "A connection set, which is open while its owner runs with this label: `owner[label]`. A connection set without an owner is \
         always open."
    Section "internal_event_actions" "internal_event_actions{\n    $0\n}"
        "The order of the instances, joined by `, ; : # ;;`."
    Section "resource" "resource ${1:name};"
        "A resource that only one process may hold at a time: `using(name)` waits for it."
    Section "supervision" "supervision{\n    strategy ${1:one_for_all};\n    restarts ${2:3} within ${3:10 s};\n}"
        "The fate of the programs of the group when one of them dies."
    Section "on_boot" "on_boot{${1:resume}}"
        "The action of the home on the deployment after a reboot of its machine: `none` (the deployment is not started again), or \
         `resume`. Only in `main`."
    Section "verify" "verify{\n    $0\n}"
        "The sentences that must hold of this process in every order of events; `dca verify` proves it."
    ModuleItem "in" "in ${1:In}: ${2:Type};"
        "An input, and the type of message that it takes; `optional` if the module works without it."
    ModuleItem "out" "out ${1:Out}: ${2:Type};"
        "An output, and the type of message that it sends."
    ModuleItem "proc" "proc ${1:Name}(${2:Type}) -> ${3:Type};"
        "A procedure that other processes may call; `idle` if it also answers while its process does not run."
    ModuleItem "state" "state ${1:name}: ${2:Type};"
        "A state that other processes may read."
    ModuleItem "calls" "calls ${1:Name}(${2:Type}) -> ${3:Type};"
        "A procedure of another process that the module calls; `optional` if the module works without it."
    ModuleItem "init" "init ${1:goal}: ${2:Type};"
        "The start value of the module: `process with value`, or the value of the previous process."
    ModuleItem "service" "service;"
        "The module never ends by itself. `,` does not wait for this module, and its loss lets the composition fail at once."
    ModuleItem "done" "done;"
        "The module ends by itself, so `,` waits for this end, and `;` then starts the next operand."
    ModuleItem "plain" "plain;"
        "Any program: exit code 0 is DONE, anything else ABORTED."
    ModuleItem "remembers" "remembers;"
        "The module keeps state from one calculation to the next, so it may not be restarted alone (`restart`)."
    ModuleItem "exec" "exec \"$0\";"
        "The program that runs the module, and its arguments."
    ModuleItem "python" "python \"$0\";"
        "The program in Python that runs the module; `dca` asks the program for its interface."
    ModuleItem "venv" "venv \"${1:.venv}\";"
        "The virtual environment whose interpreter runs the Python program of the module."
    ModuleItem "action" "action \"/${1:name}\": ${2:ros.nav2.NavigateToPose};"
        "The action of ROS 2 that the module stands for: the start value is the goal, and the result is the value that the module leaves."
    ModuleItem "ros" "ros \"${1:package} ${2:executable}\";"
        "The program of ROS 2 that runs the module: a package and an executable, or a package and a launch file."
    ModuleItem "setup" "setup \"${1:/opt/ros/jazzy/setup.bash}\";"
        "The file to source before DCA looks for the ROS 2 program of the module and starts it."
    ModuleItem "node" "node \"/${1:name}\";"
        "The name of the module's ROS 2 node, with the namespace."
    ModuleItem "remap" "remap \"${1:/from}\" -> \"${2:/to}\";"
        "Another name for a topic or a service of the module's ROS 2 program."
    ModuleItem "params" "params \"${1:params.yaml}\";"
        "A file with parameters of the module's ROS 2 program."
    ModuleItem "components" "components{\n    ${1:name} \"${2:package} ${3:class}\";\n}"
        "The components that the ROS 2 program of the module loads when its process starts. The program is a container of components. \
         `components within 30 s` limits the time for this."
    ModuleItem "lifecycle" "lifecycle;"
        "The ROS 2 node of the module has a lifecycle: it is configured before the mission begins, and active while the process runs. \
         `lifecycle within 30 s` limits the time for the configuration."
    ModuleItem "env" "env{\n    ${1:NAME} = \"$0\";\n}"
        "Environment variables of the program."
    ModuleItem "inherit" "inherit ${1:NAME};"
        "Environment variables that the program inherits from the node; `ROS_*` means all names that begin with `ROS_`."
    ModuleItem "directory" "directory \"$0\";"
        "The working folder of the program, instead of the folder in which the node was started."
    ModuleItem "stop" "stop within ${1:2 s};"
        "How long the program may take to stop before it is killed."
    ModuleItem "claims" "claims ${1:device};"
        "A device of the host that only one process may write to at a time; `(read)` if the module only reads it."
    Action "skip" "skip" "Done at once."
    Action "never" "never" "Runs until it is stopped."
    Action "wait" "wait(${1:1 s})" "Done when the time has passed."
    Action "fail" "fail(\"${1:why}\")" "Aborts at once, for this reason."
    Action "any" "any ${1:2} of ($0)" "Done when this number of processes is done; the other processes are stopped."
    Action "at" "at least ${1:2} of ($0)" "Done when all processes have ended and this number of them is done."
    Action "all" "all ${1:i} in 0..${2:4} ($0)" "Written out for each `i` and joined with `,`."
    Action "each" "each ${1:i} in 0..${2:4} ($0)" "Written out for each `i` and joined with `;`."
    Action "race" "race ${1:i} in 0..${2:4} ($0)" "Written out for each `i` and joined with `#`."
    Action "retry" "retry(${1:3}) $0" "Tries again after an abort, at most this number of times."
    Action "repeat" "repeat ${1:process} until ${2:outcome}" "Runs again and again, until it is done with one of these outcomes: `repeat \
            look until found | gone`."
    Action "match" "match { ${1:outcome} => $0 }" "Continues by the outcome of the previous part: `P : match { found => Q, missing => R }`."
    Action "shield" "shield $0" "A part that may not be stopped half way: a stop waits until this part has ended, or for the time in \
            parentheses."
    Action "using" "using(${1:resource}) $0" "Waits until the resource is free, and holds the resource while the process runs."
    Suffix "else" "else $0" "`P else Q`: Q if P aborts. `P else match { timeout => Q, \"no way\" => R }` chooses by the reason."
    Suffix "finally" "finally $0" "`P finally Q`: Q runs when P has ended in any way, also when P was stopped."
    Suffix "as" "as ${1:outcome}" "`P as t`: the outcome of P is called t, for a `match`."
    Suffix "with" "with ${1:value}" "`P with v`: P starts with this value, or with the result of this name."
    Suffix "within" "within ${1:5 s}" "Aborts an operand that takes longer than this time."
    Rule "strategy" "strategy ${1:one_for_all};" "The programs that are restarted together with a program that has died: `one_for_one` \
          (no other program), `one_for_all` (all programs of the group) or `rest_for_one` (all programs that are declared after it)."
    Rule "restarts" "restarts ${1:3} within ${2:10 s};" "How many restarts the group may have within this time; at the next restart, the \
          group aborts."
    Rule "backoff" "backoff ${1:100 ms} to ${2:30 s};" "The pauses before programs that die again and again are restarted: the first \
          pause, which doubles, and the longest pause."
    Policy "runs_in" "runs_in ${1:hardware};" "The other deployment that runs the process. This deployment uses the process, and does not \
            start it."
    Policy "restart" "restart ${1:transient};" "When the program is restarted: `temporary` (never), `transient` (after a failure) or \
            `permanent`."
    Policy "backoff" "backoff ${1:100 ms} to ${2:30 s};" "The pauses before a program that dies again and again is restarted: the first \
            pause, which doubles, and the longest pause. The first restart comes at once."
    Policy "replace" "replace ${1:overlap};" "How a new program replaces the running program: `overlap`, beside the running program and \
            without a lost value, or `break_before_make`."
    Policy "watchdog" "watchdog ${1:500 ms};" "How long the program may give no sign of life before DCA ends it as hung; `none` for no \
            limit."
    Policy "ready" "ready within ${1:3 s};" "How long the program may take until it can run, at its start and in each `Init`."
    Policy "on_agent_loss" "on_agent_loss stop within ${1:3 s};" "How long the program may continue when the node of its host is gone."
    Policy "on_link_loss" "on_link_loss ${1:keep};" "The reaction of the program when the other hosts are out of reach: `keep`, `hold`, \
            or `safe_stop_after 2 s`."
    Policy "memory" "memory ${1:200 MB};" "The most memory that the program may have."
    Policy "cpu" "cpu ${1:10 min};" "The most processor time that the program may use."
    Policy "cores" "cores ${1:0.5};" "The most processors that the program may keep busy."
    Policy "pids" "pids ${1:64};" "The most processes and threads that the program may have."
    Policy "files" "files ${1:64};" "The most files that the program may have open."
    Policy "file_size" "file_size ${1:100 MB};" "The longest file that the program may write."
    Policy "nice" "nice ${1:10};" "The priority of the program at the processor: from -20 (before other programs) to 19 (after other \
            programs)."
    Policy "realtime" "realtime ${1:40};" "The real-time priority of the program, from 1 to 49; `optional` if the program may run without \
            it."
    Quality "push" "push" "The producer sends each new value. This is the default."
    Quality "pull" "pull" "The consumer fetches the latest value before each calculation."
    Quality "latch" "latch" "A reader that is connected later gets the last value at once."
    Quality "drop" "drop" "A reader that is connected later waits for the next value."
    Quality "queue" "queue ${1:1}" "The largest number of waiting values."
    Quality "rate" "rate ${1:50 Hz}" "The largest number of values per second."
    Operator "," "" "`P , Q`: both at the same time, until every task among them has ended. It does not wait for services, but the loss \
              of a service is a failure."
    Operator ";" "" "`P ; Q`: P, then Q if P did not abort."
    Operator ":" "" "`P : Q`: P, then Q if P did not abort, and the value of P initialises Q."
    Operator "=>" "" "`P : p => Q`: Q starts with nothing, and in Q `R with p` starts R with the value of P. `match { found => Q }`: Q if the outcome is `found`."
    Operator "#" "" "`P # Q`: both at the same time; the first to end stops the other."
    Operator ";;" "" "`P ;; Q`: P, then Q, then again."
    Operator "::" "" "`P ::[n] Q`: each time P is done, a Q starts, and P begins again; at most n copies of Q run at once."
    Operator "&" "" "`P & Q`: both at the same time; the first to abort stops the other."
    Operator "?" "" "`P?`: an abort of P is tolerated."
    Inside "instof" "instof ${1:Type}($0);" "`name instof Type(arguments);` makes an instance of a process or a module."
    Inside "optional" "optional" "The module works without this input."
    Inside "of" "of" "`any 2 of (P, Q, R)`: done when this number of them is done."
    Inside "until" "until ${1:outcome}" "`repeat P until found | gone`: P runs again until it is done with one of these outcomes."
    Inside "pause" "pause ${1:1 s}" "`retry(3, pause 2 s) P`: waits this time before each try."
    Inside "read" "read" "The module only reads the device: any number of processes may read it, but not while a process writes to it."
    Sentence "never" "never ${1:a} with ${2:b};" "`never a with b`: a and b are never active at the same time, not even while one of them \
              stops."
    Sentence "exclusive" "exclusive ${1:a}, ${2:b};" "`exclusive a, b, c`: no two of these processes are ever active at the same time. \
              For a device: no two processes that claim it."
    Sentence "always" "always ${1:a} implies ${2:b};" "`always a implies b`: while a runs and is not being stopped, b is active."
    Sentence "after" "after ${1:a}.done: ${2:b} stopped;" "`after a.done: b stopped within 2 s`, `never b`, `eventually b`: a condition \
              that holds after this event."
    Sentence "once" "once ${1:a} runs: never ${2:b} with ${3:c};" "`once a runs: never b with c`, `always b implies c`, `never b`, \
              `eventually b`, `b stopped`: a condition that holds from the first start of a on."
    Sentence "eventually" "eventually ${1:a};" "`eventually b`: in every run without failures, the process b starts, or the event b \
              happens."
    Sentence "can finish" "can finish;" "The group can be done, and it can end from every state that it can reach."
    Sentence "finishes within" "finishes within ${1:90 s};" "Limits, pauses and declared durations add up to no more than this time."
    Sentence "stops within" "stops within ${1:2 s};" "A stop takes no longer than this time: limits of programs, `shield` and `finally`."
    Sentence "on crash of" "on crash of ${1:any}: ${2:b} stopped;" "A condition that holds once a program has died: `on crash of any: b \
              stopped`."
    Sentence "on hang of" "on hang of ${1:a}: ${2:b} stopped within ${3:7 s};" "A condition that holds while a program never ends by \
              itself: something else has to end b."
    Sentence "on loss of host" "on loss of host(${1:c1}): ${2:not done};" "A condition that holds once every program on this host is lost."
    Sentence "assume" "assume ${1:a} takes ${2:1 s} .. ${3:5 s};" "An assumption, which is not proved: the process has this duration, as \
              if its module declared it."
    Sentence "holds ltl" "holds ltl \"${1:G (a -> F b.done)}\";" "A formula of linear temporal logic, for conditions that no other \
              sentence can say: `G` always, `F` at some time, `U` until, `W` until or for ever, `R`."
    InSentence "with" "with" "`never a with b`: a and b are never active at the same time, not even while one of them stops."
    InSentence "implies" "implies" "`always a implies b`: while a runs and is not being stopped, b is active."
    InSentence "only after" "only after ${1:a}.done;" "`b only after a.done`: b never starts before a is done."
    InSentence "at most" "at most ${1:once};" "`a at most once`, `a at most 3 times`: a is not started more often."
    InSentence "after" "after" "`b only after a.done`: b never starts before a is done."
    InSentence "the" "the ${1:2nd} start of ${2:a}" "`after the 2nd start of a`, `end of a`, `abort of a`, `after the 2nd a.done`: only \
                this occurrence of the event counts, from `1st` to `16th`."
    InSentence "start of" "start of ${1:a}" "`after the 2nd start of a`: the process is activated, or its program begins again."
    InSentence "end of" "end of ${1:a}" "`after the 2nd end of a`: the process has ended in any way."
    InSentence "abort of" "abort of ${1:a}" "`after the 2nd abort of a`: the process fails."
    InSentence "runs" "runs: never ${1:b} with ${2:c};" "`once a runs: ...`: the sentence holds from the first start of a on."
    InSentence "always" "always ${1:b} implies ${2:c}" "`once a runs: always b implies c`: while b runs and is not being stopped, c is active."
    InSentence "exclusive" "exclusive ${1:b}, ${2:c}" "`once a runs: exclusive b, c`: no two of these processes are ever active at the same time."
    InSentence "most" "most" "`a at most once`, `a at most 3 times`: a is not started more often."
    InSentence "once" "once;" "`a at most once`, `a at most 3 times`: a is not started more often."
    InSentence "stopped" "stopped" "`b stopped`: once all stops are answered, b does not run; `b stopped within 2 s`: the stops also take \
                no longer than 2 s."
    InSentence "within" "within ${1:2 s}" "At most this time."
    InSentence "never" "never" "After the event, this never happens."
    InSentence "not" "not" "After the event, this never happens."
    InSentence "eventually" "eventually" "After the event, this can still happen in every run, and it does happen if nothing fails."
    InSentence "takes" "takes ${1:1 s} .. ${2:5 s}" "The shortest and the longest duration of the process."
    InSentence "crash of" "crash of ${1:any}" "A program dies."
    InSentence "hang of" "hang of ${1:any}" "From now on, a program never ends by itself."
    InSentence "loss of host" "loss of host(${1:c1})" "Every program on a host is lost."
    InSentence "of" "of" "`on crash of any`, `on hang of a`, `on loss of host(c1)`."
    InSentence "any" "any" "Any one program below the group."
    InSentence "host" "host(${1:c1})" "A host of the plan."
    InSentence "finish" "finish" "`can finish`: the group can be done, and it can end from every state that it can reach."
    InSentence "ltl" "ltl \"$0\"" "A formula of linear temporal logic."
    Event "done" "done" "The process is done; `a.done.found` asks for the outcome. Without a name, the group itself is meant."
    Event "aborted" "aborted" "The process fails."
    Event "started" "started" "The process is activated."
    Event "ended" "ended" "The process has ended in any way."
    Event "running" "running" "The process is active, and neither it nor a group around it is being stopped."
    Event "stopping" "stopping" "The process is active, and it or a group around it is being stopped."
    Formula "G" "G " "`G f`: f holds from here on."
    Formula "F" "F " "`F f`: f holds here or later."
    Formula "U" "U " "`f U g`: g holds here or later, and f until then."
    Formula "W" "W " "`f W g`: f holds until g holds, or for ever."
    Formula "R" "R " "`f R g`: g holds up to and with the first f, or for ever."
    Inside "write" "write" "The module moves or changes the device, and is the only process that uses it."
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::syntax::SyntaxKind;

    #[test]
    fn every_operator_is_explained() {
        for kind in SyntaxKind::OPERATORS {
            // A description without backquotes is not a word.
            let Some(text) = kind.describe().strip_prefix('`').and_then(|text| text.strip_suffix('`')) else {
                continue;
            };
            let places = [Place::Action, Place::Suffix, Place::Operator];
            assert!(find(text, &places).is_some(), "{text}: it needs a line in `words!`");
        }
    }
}
