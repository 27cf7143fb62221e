//! A large spec, made up.

/// Lines of the generated spec.
const LINES: usize = 100_000;

/// A spec of many groups, each used once, with connections and event actions.
pub(crate) fn large_spec() -> String {
    let mut text = String::new();
    let mut main = String::new();
    let mut actions = Vec::new();
    let mut lines = 0;
    while lines < LINES {
        let n = actions.len();
        let mut group = format!("process Group{n}(host1) {{\n    host{{host1}}\n    instantiated_processes {{\n");
        for leaf in 0..8 {
            group += &format!("        leaf{leaf} instof Leaf(host1, {leaf} ms);\n");
        }
        group += "    }\n";
        for leaf in 0..21 {
            let (from, to) = (leaf % 7, leaf % 7 + 1);
            group += &format!("    internal_connections(leaf{from}, set{leaf}) {{\n");
            group += &format!(
                "        leaf{from}, Out -> leaf{to}, In;\n        leaf{from}.Out -> leaf{to}.In{leaf};\n    }}\n"
            );
        }
        group += "    internal_event_actions {\n        (leaf0[set0], leaf1[set1], leaf2) #\n        (leaf3 ; leaf4 ; leaf5) #\n        (leaf6 , leaf7)\n    }\n}\n";
        lines += group.lines().count();
        text += &group;
        main += &format!("        g{n} instof Group{n}(c1);\n");
        actions.push(format!("g{n}"));
    }
    text + &format!(
        "process main() {{\n    instantiated_processes {{\n{main}    }}\n    internal_event_actions {{ {} }}\n}}\n",
        actions.join(" ;\n")
    )
}
