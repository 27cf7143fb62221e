//! The rules of the manual: the heading, the rule, and runs. P, Q, R and W are tasks, S and U services, M has the outcomes t
//! and u.

/// `expression | event: reaction | ...`
pub(crate) const RULES: &[(&str, &str, &[&str])] = &[
    (
        "`P ; Q`",
        "P done(v): Q starts, with nothing. The outcome of Q is the outcome of `P ; Q`.",
        &[
            "P ; Q | start s: P(s) | P done v: Q() | Q done w: done(w)",
            "P ; Q | start s: P(s) | P done v: Q() | Q abort r: aborted(r)",
        ],
    ),
    ("`P ; Q`", "P aborted(r): aborted(r). Q does not start.", &["P ; Q | start s: P(s) | P abort r: aborted(r)"]),
    (
        "`P ; Q`",
        "A stop goes to the operand that runs. If Q has not started, Q never starts.",
        &[
            "P ; Q | start s: P(s) | stop: stop P | P stopped: stopped",
            "P ; Q | start s: P(s) | P done v: Q() | stop: stop Q | Q stopped: stopped",
        ],
    ),
    ("`P : Q`", "P done(v): Q starts with v.", &["P : Q | start s: P(s) | P done v: Q(v) | Q done w: done(w)"]),
    (
        "`P : Q`",
        "All other rules are as in `P ; Q`.",
        &[
            "P : Q | start s: P(s) | P abort r: aborted(r)",
            "P : Q | start s: P(s) | P done v: Q(v) | Q abort r: aborted(r)",
            "P : Q | start s: P(s) | stop: stop P | P done v: stopped",
        ],
    ),
    (
        "`P ;; Q`",
        "P done(v): Q starts with v. Q done: P starts, with nothing.",
        &["P ;; Q | start s: P(s) | P done v: Q(v) | Q done w: P() | P done x: Q(x)"],
    ),
    (
        "`P ;; Q`",
        "P or Q aborted(r): aborted(r).",
        &[
            "P ;; Q | start s: P(s) | P abort r: aborted(r)",
            "P ;; Q | start s: P(s) | P done v: Q(v) | Q abort r: aborted(r)",
        ],
    ),
    (
        "`P ;; Q`",
        "`P ;; Q` is never done, so it is a service. `P ;; Q = P : (Q ; (P ;; Q))`.",
        &["P ;; Q | kind: service"],
    ),
    (
        "`P ::[n] Q`",
        "P done(v): a free place of the pool starts Q with v, and P starts again. If no place is free, P starts again when a place is free.",
        &[
            "P ::[2] W | start s: P(s) | P done v: W_0(v), P() | P done w: W_1(w), P() | P done x: | W_0 done y: W_0(x), P()",
        ],
    ),
    (
        "`P ::[n] Q`",
        "Q done: its place is free.",
        &["P ::[2] W | start s: P(s) | P done v: W_0(v), P() | W_0 done x: | P done y: W_0(y), P()"],
    ),
    (
        "`P ::[n] Q`",
        "P or Q aborted(r): P is stopped, and the copies of Q that run continue to their end; then aborted(r).",
        &[
            "P ::[2] W | start s: P(s) | P done v: W_0(v), P() | P done w: W_1(w), P() | W_0 abort r: stop P | P stopped: | W_1 done x: aborted(r)",
            "P ::[2] W | start s: P(s) | P done v: W_0(v), P() | P abort r: | W_0 done x: aborted(r)",
        ],
    ),
    ("`P ::[n] Q`", "`P ::[n] Q` is never done, so it is a service.", &["P ::[2] W | kind: service"]),
    (
        "`P : match { ... }`",
        "P done with the tag t and the value v: the arm called t starts with v. The outcome of the arm is the outcome.",
        &[
            "M : match { t => P, u => Q } | start s: M(s) | M done t:v: P(v) | P done w: done(w)",
            "M : match { t => P, u => Q } | start s: M(s) | M done u:v: Q(v) | Q abort r: aborted(r)",
        ],
    ),
    (
        "`P : match { ... }`",
        "No arm is called t: the arm `else` starts, with tag and value unchanged. `dca check` requires an arm for every outcome, or `else` (E0420).",
        &["M : match { t => P, else => Q } | start s: M(s) | M done u:v: Q(u:v)"],
    ),
    (
        "`P : match { ... }`",
        "P aborted(r): aborted(r), as with any `:`.",
        &["M : match { t => P, u => Q } | start s: M(s) | M abort r: aborted(r)"],
    ),
    (
        "Repeat",
        "P done with one of the named tags: the outcome is the outcome of P, with tag and value unchanged.",
        &[
            "repeat M until t | start s: M(s) | M done t:v: done(t:v)",
            "repeat M until t|u | start s: M(s) | M done u:v: done(u:v)",
            "repeat M until t : match { t => P } | start s: M(s) | M done t:v: P(v) | P done w: done(w)",
        ],
    ),
    (
        "Repeat",
        "P done in any other way: P starts again, with nothing.",
        &[
            "repeat M until t | start s: M(s) | M done u:v: M() | M done u:w: M() | M done t:x: done(t:x)",
            "repeat (M : match { t => P as t, u => Q }) until t | start s: M(s) | M done u:v: Q(v) | Q done w: M()",
        ],
    ),
    (
        "Repeat",
        "P aborted(r): aborted(r). A stop stops P.",
        &[
            "repeat M until t | start s: M(s) | M done u:v: M() | M abort r: aborted(r)",
            "repeat M until t | start s: M(s) | M done u:v: M() | stop: stop M | M done u:w: stopped",
        ],
    ),
    (
        "`P , Q`",
        "Every *task* has ended: the services are stopped; then done(v), where v is the list of the tasks' values, in the order of the text, or aborted(r) with the first failure.",
        &[
            "P, Q, S | start s: P(s), Q(s), S(s) | Q done y: | P done x: stop S | S stopped: done(x+y)",
            "P, Q | start s: P(s), Q(s) | Q abort r: | P abort q: aborted(r)",
        ],
    ),
    (
        "`P , Q`",
        "A task aborts: the other operands continue; at the end, the outcome is the first failure.",
        &["P, Q, S | start s: P(s), Q(s), S(s) | P abort r: | Q done y: stop S | S stopped: aborted(r)"],
    ),
    (
        "`P , Q`",
        "A *service* aborts, or ends unexpectedly: all other operands are stopped; then aborted(r).",
        &[
            "P, S | start s: P(s), S(s) | S abort r: stop P | P stopped: aborted(r)",
            "P, S | start s: P(s), S(s) | S done v: stop P | P stopped: aborted(ended)",
        ],
    ),
    (
        "`P , Q`",
        "If all operands are services, `P , Q` is a service, and the loss of one service ends it in the same way.",
        &["S, U | kind: service | start s: S(s), U(s) | S abort r: stop U | U stopped: aborted(r)"],
    ),
    (
        "`P # Q`",
        "The first outcome, done(v) or aborted(r), is the outcome; it is reported when all other operands have stopped.",
        &[
            "P # Q | start s: P(s), Q(s) | P done v: stop Q | Q stopped: done(v)",
            "P # Q | start s: P(s), Q(s) | Q abort r: stop P | P done v: aborted(r)",
        ],
    ),
    (
        "`P # Q`",
        "With more than two operands all losers are stopped at once.",
        &["P # Q # R | start s: P(s), Q(s), R(s) | Q done v: stop P, stop R | R stopped: | P stopped: done(v)"],
    ),
    (
        "`P & Q`",
        "All done: done(v), where v is the list of their values, in the order of the text.",
        &["P & Q | start s: P(s), Q(s) | Q done y: | P done x: done(x+y)"],
    ),
    (
        "`P & Q`",
        "One operand aborts: the other operands are stopped at once; then aborted(r).",
        &["P & Q | start s: P(s), Q(s) | P abort r: stop Q | Q stopped: aborted(r)"],
    ),
    ("`P else Q`", "P done(v): done(v). Q does not start.", &["P else Q | start s: P(s) | P done v: done(v)"]),
    (
        "`P else Q`",
        "P aborted(r): Q starts with r, as text. The outcome of Q is the outcome of `P else Q`.",
        &[
            "P else Q | start s: P(s) | P abort r: Q(r) | Q done w: done(w)",
            "P else Q | start s: P(s) | P abort r: Q(r) | Q abort q: aborted(q)",
        ],
    ),
    (
        "`P else match { ... }`",
        "P done(v): done(v). No arm starts.",
        &["P else match { reported => Q, else => R } | start s: P(s) | P done v: done(v)"],
    ),
    (
        "`P else match { ... }`",
        "P aborted(r): the first arm that names this reason starts with r, as text. The outcome of the arm is the outcome.",
        &[
            "P else match { reported => Q, crash => R } | start s: P(s) | P crash: R(crash) | R abort r: aborted(r)",
            "P else match { crash => Q, host_lost => R } | start s: P(s) | P host_lost: R(host lost)",
            "(P , Q) else match { crash => R, reported => skip } | start s: P(s), Q(s) | P crash: | Q abort r: R(crash)",
            "(S , P) else match { reported => R } | start s: S(s), P(s) | P abort r: stop S | S stopped: R(r)",
            "(S , P) else match { crash => Q } | start s: S(s), P(s) | S crash: stop P | P stopped: Q(crash)",
            "(P & Q) else match { crash => R } | start s: P(s), Q(s) | P crash: stop Q | Q abort r: R(crash)",
            "(P # Q) else match { crash => R } | start s: P(s), Q(s) | Q crash: stop P | P stopped: R(crash)",
            "(any 2 of (P, Q)) else match { crash => R } | start s: P(s), Q(s) | P crash: stop Q | Q stopped: R(crash)",
            "(P ; Q) else match { crash => R } | start s: P(s) | P done v: Q() | Q crash: R(crash)",
            "(P else Q) else match { crash => R } | start s: P(s) | P abort r: Q(r) | Q crash: R(crash)",
            "retry(1) P else match { crash => R } | start s: P(s) | P abort r: P(r) | P crash: R(crash)",
            "(P finally Q) else match { crash => R } | start s: P(s) | P crash: Q() | Q abort r: R(crash)",
            "P within d else match { timeout => R, else => Q } | start s: P(s) | P crash: Q(crash)",
            "P within d else match { timeout => skip } | start s: P(s) | time: stop P | P stopped: done()",
            "P within d else match { timeout => R, stop_unconfirmed => skip } | start s: P(s) | time: stop P | P unconfirmed: done()",
            "P else match { busy => Q, reported => R } | start s: P(s) | P abort r: R(r) | R done w: done(w)",
            "(P ; fail(\"no\")) else match { \"no\" => Q, else => R } | start s: P(s) | P done v: Q(no) | Q abort q: aborted(q)",
            "S else match { service_ended => Q, else => R } | start s: S(s) | S done v: Q(service ended)",
            "(M : match { t => P, else => fail(\"no\") }) else match { \"yes\" => Q, \"no\" => R } | start s: M(s) | M done u:v: R(no)",
        ],
    ),
    (
        "`P else match { ... }`",
        "No arm names this reason: the arm `else` starts. Without `else` the failure stays: aborted(r).",
        &[
            "P else match { busy => Q, else => R } | start s: P(s) | P abort r: R(r)",
            "P else match { busy => Q, timeout => R } | start s: P(s) | P abort r: aborted(r)",
        ],
    ),
    (
        "`P else match { ... }`",
        "A stop goes to the operand that runs.",
        &[
            "P else match { reported => Q } | start s: P(s) | stop: stop P | P abort r: stopped",
            "P else match { reported => Q } | start s: P(s) | P abort r: Q(r) | stop: stop Q | Q done w: stopped",
        ],
    ),
    (
        "`P finally Q`",
        "P has ended: Q starts, with nothing. Q done: the outcome is the outcome of P.",
        &[
            "P finally Q | start s: P(s) | P done v: Q() | Q done w: done(v)",
            "P finally Q | start s: P(s) | P abort r: Q() | Q done w: aborted(r)",
        ],
    ),
    (
        "`P finally Q`",
        "Q aborted(r): aborted(r) if P was done; otherwise the outcome of P.",
        &[
            "P finally Q | start s: P(s) | P done v: Q() | Q abort r: aborted(r)",
            "P finally Q | start s: P(s) | P abort p: Q() | Q abort r: aborted(p)",
        ],
    ),
    (
        "`P finally Q`",
        "A stop while P runs: P is stopped. When P has confirmed the stop, Q starts. When Q has ended: stopped.",
        &[
            "P finally Q | start s: P(s) | stop: stop P | P stopped: Q() | Q done w: stopped",
            "P finally Q | start s: P(s) | stop: stop P | P stopped: Q() | Q abort r: stopped",
            "P finally Q | start s: P(s) | stop: stop P | P unconfirmed: Q() | Q done w: aborted(unconfirmed)",
            "(P finally Q) # R | start s: P(s), R(s) | R done v: stop P | P stopped: Q() | Q done w: done(v)",
        ],
    ),
    (
        "`P finally Q`",
        "A stop while Q runs: the stop waits until Q has ended in any way; then stopped.",
        &[
            "P finally Q | start s: P(s) | P done v: Q() | stop: | Q done w: stopped",
            "P finally Q | start s: P(s) | P abort r: Q() | stop: | Q abort q: stopped",
        ],
    ),
    (
        "`P as t`",
        "P done(v): done(v) with the tag t.",
        &[
            "P as t | start s: P(s) | P done v: done(t:v)",
            "(P as p # Q as q) : match { p => R, q => W[0] } | start s: P(s), Q(s) | Q done v: stop P | P stopped: W_0(v)",
        ],
    ),
    ("`P as t`", "P aborted(r): aborted(r).", &["P as t | start s: P(s) | P abort r: aborted(r)"]),
    (
        "Names for results",
        "`p => Q` starts with v: Q starts, with nothing. In Q, `R with p` is `R with v`.",
        &[
            "p => (P ; R with p) | start v: P() | P done u: R(v)",
            "P : p => (Q with p ; R with p) | start s: P(s) | P done v: Q(v) | Q done u: R(v)",
            "M : match { t p => P with p, u => Q } | start s: M(s) | M done t:v: P(v)",
            "M : p => (P ; (match { t q => Q with q, u => R }) with p) | start s: M(s) | M done t:v: P() | P done x: Q(v)",
            "p => (P ; retry(1) (R with p)) | start v: P() | P done u: R(v) | R abort r: R(v)",
        ],
    ),
    (
        "Names for results",
        "Q done(u): done(u). Q aborted(r): aborted(r).",
        &[
            "p => (P with p) | start v: P(v) | P done u: done(u)",
            "p => (P with p) | start v: P(v) | P abort r: aborted(r)",
        ],
    ),
    (
        "Names for results",
        "A stop goes to Q. The value is kept until Q has ended.",
        &[
            "p => (P with p) | start v: P(v) | stop: stop P | P stopped: stopped",
            "p => (P finally (R with p)) | start v: P() | stop: stop P | P stopped: R(v) | R done u: stopped",
        ],
    ),
    (
        "`P with v`",
        "P starts with v, and ignores the value of the previous process.",
        &[
            "P with true | start s: P(\u{1})",
            "(P ; Q) with true | start s: P(\u{1}) | P done w: Q()",
            "(P, S) with true | start s: P(\u{1}), S(\u{1})",
        ],
    ),
    (
        "`P with v`",
        "P done(u): done(u). P aborted(r): aborted(r).",
        &[
            "P with true | start s: P(\u{1}) | P done u: done(u)",
            "P with true | start s: P(\u{1}) | P abort r: aborted(r)",
            "P with true | start s: P(\u{1}) | stop: stop P | P stopped: stopped",
        ],
    ),
    (
        "`P within d`",
        "P ends in time: its outcome.",
        &["P within 5 s | start s: P(s) | P done v: done(v)", "P within 5 s | start s: P(s) | P abort r: aborted(r)"],
    ),
    (
        "`P within d`",
        "The time has passed: P is stopped; then aborted(deadline).",
        &["P within 5 s | start s: P(s) | time: stop P | P stopped: aborted(deadline)"],
    ),
    ("`P within d`", "`P within d = P # (wait(d) ; fail(\"deadline\"))`", &[]),
    (
        "Shield",
        "Without a stop: the same as P.",
        &["shield P | start s: P(s) | P done v: done(v)", "shield P | start s: P(s) | P abort r: aborted(r)"],
    ),
    (
        "Shield",
        "A stop: P continues until it has ended in any way; then stopped. With a bound, P is stopped when d has passed.",
        &[
            "shield P | start s: P(s) | stop: | P done v: stopped",
            "shield P | start s: P(s) | stop: | P abort r: stopped",
            "shield(5 s) P | start s: P(s) | stop: | time: stop P | P stopped: stopped",
        ],
    ),
    (
        "Using",
        "All named resources are free, and no other `using` has waited longer for one of them: the `using` takes the resources, and P starts.",
        &[
            "using(arm) P, using(arm, table) Q, using(table) R | start s: P(s) | P done x: Q(s) | Q done y: R(s) | R done z: done(x+y+z)",
        ],
    ),
    (
        "Using",
        "Otherwise the `using` waits, first come, first served. A stop during this wait: stopped at once.",
        &[
            "using(arm) P, using(arm) Q, using(arm) R | start s: P(s) | P done x: Q(s) | Q done y: R(s)",
            "using(arm) P, using(arm) Q | start s: P(s) | stop: stop P | P stopped: stopped",
        ],
    ),
    (
        "Using",
        "P has ended: all resources are free again, after P has cleaned up. The outcome is the outcome of P. If the host of P is lost, P has failed, but may still move something. Every other `using` of `arm` waits until that host has reported that P has ended, or that it runs nothing of the mission; the summary lists the waiting processes. The same rule applies to a program that could not be ended: its resources stay reserved until it has ended, even if an `else` or `?` has tolerated the failure. `dca status` lists the holders, and the processes to end. Until this end, no other process of the mission may use a device that the program `claims`: such a process aborts.",
        &[
            "using(arm) P | start s: P(s) | P done v: done(v)",
            "using(arm) P | start s: P(s) | P abort r: aborted(r)",
            "((using(arm) P) # R), using(arm) Q | start s: P(s), R(s) | R done v: stop P | P stopped: Q(s)",
        ],
    ),
    (
        "Any ... of",
        "k operands are done: the other operands are stopped; then done(v), where v is the list of the k values.",
        &["any 2 of (P, Q, R) | start s: P(s), Q(s), R(s) | R done z: | P done x: stop Q | Q stopped: done(x+z)"],
    ),
    (
        "Any ... of",
        "So many operands have failed that k operands can no longer be done: the others are stopped; then aborted(r) with the first failure.",
        &["any 2 of (P, Q, R) | start s: P(s), Q(s), R(s) | Q abort q: | P abort r: stop R | R stopped: aborted(q)"],
    ),
    (
        "At least ... of",
        "All operands have ended, and k or more are done: done, with nothing.",
        &[
            "at least 1 of (P, Q, R) | start s: P(s), Q(s), R(s) | P done x: | Q abort q: | R done z: done()",
            "at least 2 of (P, Q) | start s: P(s), Q(s) | P done x: | Q done y: done()",
        ],
    ),
    (
        "At least ... of",
        "All operands have ended, and fewer than k are done: aborted(r) with the first failure.",
        &["at least 2 of (P, Q, R) | start s: P(s), Q(s), R(s) | Q abort q: | P abort r: | R done z: aborted(q)"],
    ),
    (
        "At least ... of",
        "A stop goes to all operands that run.",
        &["at least 1 of (P, Q) | start s: P(s), Q(s) | P done x: | stop: stop Q | Q stopped: stopped"],
    ),
    (
        "Constants",
        "`skip` is done at once, with nothing. Started with nothing, `skip ; P = P`.",
        &["skip | start s: done()"],
    ),
    (
        "Constants",
        "`never` runs until it is stopped. `never # P = P`.",
        &["never | kind: service | start s: | stop: stopped"],
    ),
    ("Constants", "`fail(\"why\")` aborts at once, for this reason.", &["fail(\"why\") | start s: aborted(why)"]),
];
