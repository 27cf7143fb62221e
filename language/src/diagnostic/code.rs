//! The codes of all diagnostics. A code never changes its meaning.

use super::Severity;
use std::fmt;

macro_rules! codes {
    ($($name:ident $severity:ident $title:literal $explanation:literal)*) => {
        /// The stable code of a kind of diagnostic.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Code {
            $(#[doc = $title] $name,)*
        }

        impl Code {
            /// Every code.
            pub const ALL: &'static [Self] = &[$(Self::$name,)*];

            /// Returns the code in its printed form: `E0201`.
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => stringify!($name),)*
                }
            }

            /// Returns its title, in a few words.
            pub fn title(self) -> &'static str {
                match self {
                    $(Self::$name => $title,)*
                }
            }

            /// Returns its meaning and advice, in a paragraph.
            pub fn explanation(self) -> &'static str {
                match self {
                    $(Self::$name => $explanation,)*
                }
            }

            /// Returns how bad it is unless options say otherwise.
            pub fn severity(self) -> Severity {
                match self {
                    $(Self::$name => Severity::$severity,)*
                }
            }
        }
    };
}

impl Code {
    /// Returns the code that is printed so, in any case.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|code| code.as_str().eq_ignore_ascii_case(text.trim()))
    }
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

codes! {
    E0001 Error "unexpected text"
        "The parser expected something else here. If one token is missing, the fix inserts it."
    E0002 Error "unfinished string or comment"
        "A string ends on its line with `\"`; a comment that starts with `/*` ends with `*/`."
    E0003 Error "unknown character"
        "The character has no meaning outside of strings and comments."
    E0004 Error "nested too deeply"
        "Groups and expressions nest at most 64 levels. Split the expression, or make a group of a part of it."
    E0005 Error "`; ;`"
        "`;;` without a blank repeats, and `;` goes on to the next step. `; ;` could mean either."
    E0006 Error "not supported yet"
        "The form belongs to the language, but this version cannot run it."
    E0007 Error "text too long"
        "The compiler reads texts of at most 16 MiB."
    W0007 Warning "no effect yet"
        "The word belongs to the language but this version ignores it."
    E0008 Error "unknown unit"
        "A quantity is a number with a unit: s ms us ns min h, m mm cm km, rad deg, Hz kHz, N kN Nm, kg g, A mA, V mV, B kB MB, or a quotient of two units: m/s, rad/s, N/m."
    E0009 Error "wrong quantity"
        "This place needs another kind of value: a time such as `5 s`, or a count. If the value comes from a parameter of the group, the argument for this parameter is wrong."
    W0009 Warning "empty statement"
        "This `;` ends nothing, and is ignored."
    E0010 Error "unreadable file"
        "A used file or folder cannot be read. Its path is relative to the file that uses it. A used folder contains at least one `.dca` file."
    E0011 Error "no such program"
        "An `exec` names a program and its arguments, separated by blanks. A word that has blanks stands between `'` or `\"`. No shell runs it. A variable in `env` has a name of letters, digits and `_`, which occurs once in its module. Names that begin with `DCA_` are reserved for the node. `inherit` takes names of variables, or the beginning of such names: `ROS_*`."
    W0012 Warning "digits lost"
        "A number keeps 53 bits, which are 15 to 16 digits. This number has more digits, so the program gets a rounded number. If the value is a text instead, the program gets all its digits."
    E0101 Error "no root"
        "A spec starts with `process main()`. Without `main`, the root is the only process that no other process instantiates. In this spec there is no such process, or more than one."
    W0101 Warning "no `main`"
        "The root is the only process that no other process instantiates. The parameters of the root have no values, so the name of each parameter is its value."
    E0102 Error "recursive instantiation"
        "A process group contains itself, directly or through other groups. The plan of this group would have no end."
    E0103 Error "type that contains itself"
        "A record contains itself, directly or through other records. A value of this type would have no end."
    W0105 Warning "no host"
        "A group without a `host` section has its supervisor on the host of the group around it. A module that needs a host, but gets no host, runs on the host of its group."
    W0106 Warning "not a parameter"
        "A name in an argument or a host section is a parameter of the group. Any other name is a text."
    E0107 Error "not a host"
        "A host is a name or a string: at most 63 letters, digits, `_`, `-` and `.`, beginning with a letter or a digit. If a parameter of a group is used as a host, its argument must be a host."
    E0108 Error "not an interface"
        "The interfaces that a program prints consist of `module` blocks and `type`s only."
    E0110 Error "defined twice"
        "A name is defined once: process, type, parameter, field, instance, port, connection set, section."
    E0111 Error "policy of a group"
        "`runs_in`, `restart`, `replace`, `backoff`, `watchdog`, `ready`, `on_agent_loss`, `on_link_loss`, `memory`, `cpu`, `cores`, `pids`, `files`, `file_size`, `nice` and `realtime` apply to a program. Write them in braces after an instance of a module: `laser instof Laser(c1) { nice 5; }`."
    E0112 Error "restart forgets"
        "The type declares `remembers;`: it keeps state from one calculation to the next, such as an estimate or its progress. If this program is restarted alone, it loses its state, while all other processes continue. Remove `restart`: the death of the program is then an abort, and `retry` restarts its group as a whole. A type that recovers its state, from its inputs or from the database, does not declare `remembers;`."
    E0113 Error "back-off of nothing"
        "`backoff` sets the pause before a program that has died is restarted. This program is never restarted: it has `restart temporary`, or no `restart` in a group without `supervision`, or its type `remembers`."
    E0114 Error "`on_boot` of a group"
        "`on_boot` decides whether the home of a deployment resumes it after a reboot of its machine. A deployment restarts as a whole, so this stands in `main`."
    E0115 Error "overlap that cannot hold"
        "With `replace overlap`, the next program of a process starts while the previous program still runs, and takes over its connections between two values. So the process must be a service and a controller. The process can have no devices, procedures or states, and cannot write keys of the database. Its connections must push their values, and belong to its own group."
    E0116 Error "process of another deployment"
        "An instance with `runs_in` stands for a process that another deployment runs on that host, such as the server of a device. No program is started for it, so it has no policies and no arguments of its own. Its type is a service whose interface is known, and other processes can only call its procedures and states."
    W0110 Warning "interface given twice"
        "Two programs describe the same module type. DCA uses the first description."
    W0120 Warning "never run"
        "The program of the instance is started with its group, but no event action ever runs the instance."
    W0121 Warning "nothing to do"
        "A group without event actions ends as soon as it starts."
    W0122 Warning "never instantiated"
        "The process is defined but nothing uses it."
    W0123 Warning "resource never used"
        "A group declares its resources with `resource arm;`. No `using(arm) process` takes this resource."
    W0124 Warning "moves after a power failure"
        "With `on_boot{resume}` the deployment begins by itself when the machine of its home has booted, and one of its processes alone drives a device, such as an arm. A machine that moves when its power returns is a hazard: keep people out of its reach, or write `on_boot{none}`, so that a user must start the deployment."
    E0201 Error "unknown process"
        "The name is not an instance of this group. A name means the instance with this name. If there is none, the name means, in this order: the only instance of the type with this name; the only instance whose name differs only by case; the only instance whose name is a longer or shorter form of this name."
    W0201 Warning "type name used"
        "The name is the type of exactly one instance and is read as that instance."
    W0202 Warning "case mismatch"
        "The name differs from exactly one instance only by case or `_`, and is read as that instance."
    W0203 Warning "abbreviation"
        "The name abbreviates exactly one instance, or that instance abbreviates the name. It is read as that instance."
    E0202 Error "ambiguous name"
        "The name could mean more than one instance."
    E0203 Error "wrong index"
        "`robot[4] instof Robot(hosts[i])` makes four instances, `robot[0]` to `robot[3]`; in their arguments, `i` is the index of the instance. A list can have a name: `const hosts = [c1, c2];`. An index in brackets chooses one instance; `all i in 0..4 (robot[i])` runs all four instances."
    E0204 Error "unknown resource"
        "`using(arm) process` takes a resource that the group declares with `resource arm;`. Each instance of the group has its own resources. Groups that share a resource get it from the group around them, `search instof Search(c2, arm)`, as a parameter `arm: Resource`."
    W0204 Warning "type abbreviated"
        "No type has exactly this name. One type has a name that differs only by case, or that has the same words written out."
    W0205 Warning "no interface known"
        "Neither the spec nor a program describes this module type, so its ports and arguments are not checked and it counts as a task, not as a service."
    W0206 Warning "unknown type"
        "A parameter or field may have a type that only programs know. The name of this type is similar to a known type."
    E0210 Error "wrong number of arguments"
        "An instance gives a value to each parameter without a default. The root gets no arguments, so a parameter that decides its shape needs a default."
    E0211 Error "unknown argument"
        "The name of the argument is not a parameter of the type."
    E0212 Error "argument given twice"
        "A parameter takes one value, and so does a field."
    E0213 Error "wrong kind of argument"
        "The interface declares the kind of the argument: `Text`, `Number`, `Truth`, `Secret` with `secret(\"KEY\")`, or a quantity with a unit: `Time`, `Length`, `Angle`, `Speed`, `AngularSpeed`, `Acceleration`, `Frequency`, `Mass`, `Force`, `Torque`, `Stiffness`, `Power`, `Current`, `Voltage`, `Size`, or a record: `type Grasp = { force: Force };`."
    E0214 Error "unknown field"
        "A record has the fields that its type declares. Give each field by its name: `{ force = 20 N }`."
    E0215 Error "field missing"
        "Every field of a record has a value, unless its type declares a default: `type Grasp = { force: Force = 20 N };`."
    E0216 Error "values without a name"
        "Programs get the fields of a record as arguments `name.field`, and the values of a list as `name.0` and so on. If the interface of the program is unknown, write the name: `Grip(c1, grasp = { force = 20 N })`."
    E0217 Error "value out of range"
        "A parameter can limit its values: `force: Force in 1 N..200 N`, `mode: Text in \"open\" | \"close\"`. Both ends of a range are allowed values."
    E0301 Error "unknown connection set"
        "A label in an event action names a set that is declared as `internal_connections(owner, label)`. Labels are never guessed: a wrong wire is dangerous."
    W0302 Warning "label activates nothing"
        "The process owns no connection set at all, so the label has no effect."
    E0303 Error "unknown port"
        "The port is not declared by the interface, or not exported by the group. Ports are never guessed: a wrong wire is dangerous."
    E0304 Error "wrong direction"
        "Data goes from an output to an input: `producer, Out -> consumer, In`."
    W0304 Warning "no connection set activated"
        "The process owns connection sets, but this event action opens none of these sets."
    E0305 Error "types differ"
        "Output and input of a connection have the same type."
    W0305 Warning "set of another owner"
        "The owner of a connection set is one of the processes that the set connects; by convention, it is the source. The set is open only while its owner runs."
    E0306 Error "same only by name"
        "Both ends of a connection have a type of the same name, but the two declarations of this type do not have the same fields in the same order. Values are sent field by field, so both sides must agree."
    E0307 Error "call and data"
        "A call goes from `calls Grip(Force) -> Width;` to `proc Grip(Force) -> Width;` or to a `state`, and data from an output to an input. `calls Say(QueueMessage) -> Receipt;` also goes to an input of an activity. Calls and data cannot be connected in any other way, and a call has no `pull`, `latch`, `queue` or `rate`."
    E0308 Error "keys of the database"
        "A process is connected with keys of the robot's database: `db(\"team/flat/claim/**\") -> robot, Claims;` sends an input of type `KeyNews` the present values below a prefix and then each change, and `robot, Claim -> db(\"team/flat/claim/**\");` puts the values of an output of type `KeyPut`. An input of type `KeyAnswer` receives the result of each put. `robot, database -> db(...)` lets the program itself write there. A prefix ends in `/**`; without `/**`, the text is the name of one key. Such a connection is open while the process runs: it has no owner, no label and no quality."
    E0309 Error "topics and services of ROS 2"
        "A port is connected with a topic of ROS 2: `avoid, Cmd -> topic(\"/cmd_vel\", qos = reliable(10));` publishes what an output sends, and `topic(\"/scan\", qos = sensor) -> avoid, Scan;` sends an input what others publish. The name begins at the root, and the type of the port is a message of ROS 2 such as `ros.sensor.LaserScan`. In one deployment a topic has one type and one quality of service, is published on one host, and is not published and subscribed to at the same time. Transforms (`ros.tf2.TFMessage`) may be published on any number of hosts, and subscribed to as well. In `topic(\"/tf\", frame_prefix = \"r1/\")`, the prefix stands before the names of frames in ROS 2. It ends with `/` or `_`, and a host has one prefix for a topic. A topic `/tf_static` is `transient_local(1)`. A call is connected with a service: `task, Reset -> service(\"/reset\");` calls a server of ROS 2, and `service(\"/set\") -> hand, Set;` lets clients of ROS 2 call a procedure. Its argument and result are the request and the response of one standard service, such as `ros.std_srvs.Trigger_Request` and `ros.std_srvs.Trigger_Response`. Such a connection is open while the mission runs: it has no owner, no label and no other quality. A module that is a program of ROS 2 has a package and an executable, `ros \"demo_nodes_cpp talker\";`, and no ports: connect its topics like the topics of other nodes. A node with `lifecycle` has a name, `node \"/talker\";`, and does not end."
    W0306 Warning "two writers at once"
        "Two processes send to one input, and may do so at the same time: the values arrive mixed. Only operators that run their operands one after the other separate connections: `; : ;; else`."
    W0307 Warning "connected twice"
        "One set contains the same connection twice."
    W0310 Warning "unconnected inputs"
        "Nothing is ever sent to these inputs. An interface can declare that a module works without an input: `in Port: Type optional;`."
    W0311 Warning "sender and receiver never meet"
        "A value is sent while its sender runs, its connection set is open and its receiver runs; a value for a process that does not run is dropped. Here the event actions never run sender and receiver at the same time. Run them in parallel, hand the value on with `sender : receiver`, or keep the last value with `latch`."
    W0312 Warning "unconnected calls"
        "The process calls a procedure or a state, but no connection leads to a server: each such call is refused. An interface can declare that a module works without a call: `calls Grip(Force) -> Width optional;`."
    E0401 Error "runs twice at once"
        "One instance cannot run twice at the same time. Declare a second instance."
    W0402 Warning "may never end"
        "`,` waits for each of its processes that can end. A sensor or a controller that never ends declares `service;` in its interface; then `,` ends with the others."
    W0403 Warning "never ends"
        "A service has no normal end. So the step after a service never starts, or starts only when a failure inside the service is tolerated. A sequence that ends with a service never finishes."
    W0404 Warning "operators side by side"
        "`#` binds more loosely than `;` and more tightly than `,`. Parentheses show which operands belong together."
    W0405 Warning "never starts"
        "`P ; Q` and `P : Q` start Q when P is done. This P can fail or be stopped, but is never done. For example, `camera within 10 s` always fails if the camera never ends, and so does `fail(\"why\")`. To go on after a failure write `P? ; Q` or `P else Q`."
    W0406 Warning "makes no difference"
        "This operator or operand has no effect, because of the operand beside it. `P else Q` starts Q when P fails, so Q never starts if P cannot fail, such as `skip` or `R?`. In `skip # Q` the first operand is over before Q starts."
    W0407 Warning "limit too short"
        "`P within 5 s` fails when P takes longer. The pauses in this P alone take longer than the limit, or the limit is zero."
    E0410 Error "endless loop at one instant"
        "Each round of a repeated expression must run a process or wait."
    E0411 Error "cannot be stopped"
        "`shield P` lets a stop wait until P has ended. A service has no normal end, so the shield needs a bound: `shield(10 s) P`."
    E0413 Error "waits for itself"
        "`using` gives a resource back when its process has ended. Inside this process the same resource is never free."
    W0413 Warning "may wait for each other"
        "Two processes take the same resources in different orders, or several processes take resources in a circle. When each process has its first resource, all of them wait for ever. Take both at once, `using(a, b)`, or always in the same order. A service never gives its resources back."
    W0414 Warning "had longer than used"
        "A member that gets a resource, `kitchen instof Tidy(c2, arm)`, holds the resource from its start to its end. The reason: the group that declares the resource assigns it, and does not see a `using` inside the member. Other members that get this resource wait for all of this time. Give the resource to a smaller group that contains only its users. If the long hold is intended, write `using(arm)` around the whole body of the member."
    E0420 Error "outcome without arm"
        "`match` has an arm for each outcome that the previous process declares with `done(found | missing);`, or `else` for the rest."
    E0421 Error "unknown outcome"
        "An arm of `match` names an outcome that the previous process declares with `done(found | missing);`. Each `-> done(found)` of an activity with outcomes names one of its outcomes. Outcomes are never guessed."
    W0422 Warning "arm never taken"
        "The other arms already take every possible outcome. An arm of `else match` is never taken if nothing in the operand before it fails for this reason."
    E0423 Error "nothing to match"
        "`match` chooses by the outcome of the previous process, so write it after `:`: `search : match { found => grasp, missing => home }`. The previous process declares its outcomes with `done(found | missing);`."
    W0424 Warning "value dropped"
        "In `P : Q : R` R starts with the value that Q leaves. If Q is `skip` or `wait`, also as an arm of a `match`, the value of P is lost."
    E0425 Error "no such start value"
        "`goto with { x = 2 m, y = 1 m }` starts `goto` with this value. The interface of the program declares it with a name and a type: `init goal: Place;`. A spec can write numbers, quantities, texts, truths, and records and lists of them. All programs that start with one value take the same type."
    E0426 Error "two start values"
        "In `find : goto` the value that `find` leaves starts `goto`. `goto with shelf` starts `goto` with another value. Only one value is possible: write `find ; goto with shelf`, or `find : goto`."
    E0427 Error "no such end of `repeat`"
        "`repeat look until found | gone` runs `look` again until `look` is done with one of these outcomes. The operand declares them with `done(found | gone | missing);`, or names its end: `look as found`. Outcomes are never guessed."
    W0428 Warning "never repeats"
        "Every outcome of the operand ends the `repeat`, so the operand runs once. A failure ends the `repeat` as well: `retry(3) process` tries again after a failure."
    E0429 Error "no such cause of a failure"
        "`drive else match { timeout => wait_more, \"no way\" => ask, else => home }` chooses by the reason for which `drive` has failed, and `on aborted(timeout)` of an activity asks for one: `timeout` of a `within`, `reported` for the own report of a program, `crash`, `host_lost`, `busy`, `stop_unconfirmed`, `service_ended`, `no_match`, `script_budget`, `script_failed`, or the text of a `fail` or an `abort`."
    E0430 Error "name of a result is taken"
        "In `find : p => goto with p`, the name `p` stands for the value that `find` leaves. `p` must not be the name of another result around it, of a process, a constant, a parameter, an index or a variable."
    W0431 Warning "result never used"
        "In `find : p => goto`, no process starts with `p`, so the value that `find` leaves is lost. Write `goto with p`, or `find : goto`."
    E0501 Error "claimed twice at once"
        "`claims arm;` declares that a module owns a device of its host. Two processes that may run at the same time cannot both own it; any number may claim it `(read)`, but not while another process writes to the device. Two processes inside a `using` of the same resource do not run at the same time."
    E0701 Error "too many processes"
        "A plan has at most 10,000 leaves and as many groups. The event actions of a group have at most 100,000 operators and operands, and arrays and connection sets at most 200,000 instances and connections, after arrays are written out."
    E0702 Error "too many values"
        "A record or a list has at most 1,000 values, including the values of the records inside. A process has at most 1,000 parameters."
    E0801 Error "unreadable property"
        "A `verify` block consists of sentences: `never a with b`, `always a implies b`, `b only after a.done`, `after a.done: b stopped within 2 s`, `after a.done: never b`, `after a.done: eventually b`, `after the 2nd start of a: never b`, `once a runs: never b with c`, `on crash of any: b stopped`, `on loss of host(c1): not done`, `eventually a`, `can finish`, `finishes within 90 s`, `stops within 2 s`, `exclusive a, b`, `a at most once`, `assume a takes 1 s .. 15 s`, `holds ltl \"G (a -> F b.done)\"`."
    E0802 Error "unknown name in a property"
        "A property names the members of its group as the event actions do, and the members of a member with a dot: `hit.force`. Write `done`, `aborted` and `started` after a dot, or alone for the group itself. Formulas also have `running` and `stopping`. Names are never guessed here."
    E0811 Error "gets stuck"
        "`dca verify` has found an order of events after which the group can never end any more, although no program has failed. The group is not a service, so an end is promised. Often two processes wait for each other, or one process waits for a process without an end."
    E0812 Error "never starts"
        "`dca verify` has looked at every order of events, including failures. None of these orders starts this process, or a limit around the process passes before it can start."
    E0813 Error "stop without an end"
        "`dca verify` has found an order of events after which a stop never finishes, although every program answers its own stop: the process inside a `shield` or a `finally` never ends."
    E0814 Error "two at one thing"
        "`dca verify` has found an order of events in which two processes own one device, or send to one input, at the same time."
    E0815 Error "limit shorter than its body"
        "According to the declared durations, this limit always passes before its body can be done, or before the second try of a `retry` in the body can be done."
    E0816 Error "works blind"
        "`dca verify` has looked at every order of events. This process needs an input, but whenever it runs, no sender of this input runs, or the connection is closed. A detector without input never fires."
    E0817 Error "property does not hold"
        "`dca verify` has found an order of events that breaks a sentence of a `verify` block. The story shows the shortest such order."
    E0901 Error "unknown state"
        "A transition leads to a state of its activity, to `resume`, `done` or `abort(\"why\")`. This activity has no state of that name."
    E0902 Error "states that do not fit"
        "An activity begins in its only `initial` state. A state with states inside also begins in its only `initial` state. The states inside a `parallel state` begin together and cannot be `initial`, `final` or `suspended`. A `final state` runs nothing and has no transitions. `-> resume` is allowed in a `suspended state`, `on done` in a state that runs something, and `on complete` in a state with states inside. `on entry` and `on exit` can have only actions. `-> internal STATE` leads to states inside the state of the transition, which is not `parallel`. An activity with outcomes ends by `-> done(OUTCOME)`, and not by a `final state`."
    E0903 Error "unknown name in an activity"
        "A condition or an action names a variable of the activity, a value of a variable, a state with `in(state)`, a port, or a signal. In a transition with `on done(tag value)`, `value` is the name of the value. In a transition with `on message port`, the value has the name of the port. In `where`, the message is called `text`, and its `priority` is a number from 0 to 255."
    E0904 Error "wrong value in an activity"
        "A condition compares numbers, truths and names of finite variables: `bool`, `0..3`, `slow | fast`. A condition cannot read the content of an `opaque` variable, of a message or of an outcome. Such a content can be stored, sent, given to a run, and be the value of `done`. A `where` compares `text` with a text, and `priority` with a number."
    W0905 Warning "transition never taken"
        "An earlier transition waits for the same event and has no condition, so the activity always takes the earlier transition. Or the event never occurs, because no action raises this signal, or because the activity itself ends once its states are complete."
    W0906 Warning "state never entered"
        "No transition leads to this state, and it is not an initial state."
    W0907 Warning "failures are tried again for ever"
        "After this abort, the activity returns to the same state, and waits only for ends of its runs. On this path, no variable changes that a condition reads, so the activity may try again for ever. Count the tries, or add a pause to the path."
    W0908 Warning "two transitions at one tick"
        "Each `every` is a timer of its own. So of two transitions `on every` with one time, not only the first one that fits is taken: the second one is taken at the same tick."
    E0909 Error "mistake in a script"
        "A script is text in Rhai between `script {` and `}`, and its last line is its value. It knows the variables of the activity and the value of its event, and it cannot change them. A function knows only its parameters. `dca check` also compares each call with the functions that exist. `import`, `eval`, `print`, files, clocks and the network do not exist."
    E0910 Error "type of an opaque variable"
        "A script reads and gives values of declared types: numbers, quantities, truths, texts, and records and lists of them. Declare the type of an opaque variable, `var place: opaque Pose = ();`, and of an outcome, `done(found: Pose)`. The variable then keeps only values of its type."
    E0819 Error "a run deviates"
        "`dca conform` has found a step of a supervisor in the record of a run that differs from the spec: the robot's behaviour is not the verified one. The supervisor is wrong, or another version of DCA wrote the record."
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_unique_and_explained() {
        for (index, code) in Code::ALL.iter().enumerate() {
            assert_eq!(Code::parse(code.as_str()), Some(*code));
            assert_eq!(Code::ALL.iter().position(|other| other.as_str() == code.as_str()), Some(index));
            let letter = if code.severity() == Severity::Error { 'E' } else { 'W' };
            assert!(code.as_str().starts_with(letter), "{code}");
            assert!(code.explanation().ends_with('.'), "{code}");
        }
    }
}
