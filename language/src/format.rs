//! Formats a spec: `dca fmt`. Every spec has one form.
//!
//! The formatter changes only white space, and writes `;;` for its older spelling `:;`. Tokens and comments stay in
//! their order, with two exceptions. A comment before an operator moves to the other side of the operator, where the
//! line ends. Two items have an empty line between them.
//!
//! A text that fits stays on one line. A longer text is broken at its loosest operator. An operator stays broken if the
//! author broke it. So a second run changes nothing.

mod expression;
mod piece;
mod printer;

use crate::diagnostic::{Diagnostic, Severity};
use crate::source::{Origin, Source};
use crate::syntax::{Parse, parse};
use printer::Printer;

/// The longest line, in columns, unless a line cannot be broken.
pub(crate) const COLUMNS: usize = 100;

/// Returns the formatted text.
///
/// # Errors
/// Returns the mistakes in the text. A text that cannot be read is not changed.
pub fn format(source: &Source) -> Result<String, Vec<Diagnostic>> {
    let Parse { root, mut diagnostics, .. } = parse(source, Origin::Spec);
    diagnostics.retain(|found| found.severity == Severity::Error);
    if !diagnostics.is_empty() {
        diagnostics.sort_by_key(|found| (found.primary.span, found.code));
        return Err(diagnostics);
    }
    Ok(Printer::new(&root, &source.text).file(&root))
}

#[cfg(test)]
mod tests {
    use super::*;
    use expect_test::{Expect, expect};

    fn check(text: &str, expect: &Expect) {
        let once = format(&Source::new("a.dca", text)).unwrap();
        expect.assert_eq(&once);
        assert_eq!(format(&Source::new("a.dca", &*once)), Ok(once));
    }

    #[test]
    fn groups_have_one_shape() {
        check(
            "process  main( a:Host=c1 ) { host { c1 }  external_io{\n\n} instantiated_processes { x instof X( c1,-5 m / s ) ; } internal_connections ( x , l ) { x,Out->y.In pull ; } internal_event_actions { x[ l ]<v>? within 5s:;y } } module M { service ; in In:T[6] optional; }\n\n\n",
            &expect![[r#"
                process main(a: Host = c1){
                    host{c1}
                    external_io{}
                    instantiated_processes{
                        x instof X(c1, -5 m/s);
                    }
                    internal_connections(x, l){
                        x, Out -> y.In pull;
                    }
                    internal_event_actions{
                        x[l]<v>? within 5 s ;; y
                    }
                }

                module M { service; in In: T[6] optional; }
            "#]],
        );
        check("", &expect![""]);
    }

    #[test]
    fn an_end_of_a_range_may_be_left_out() {
        check(
            "module M(a:Number in..5=3,b:Number in 1..=3,c:Text in\"a\"|\"b\",d:Force in-1N..2 N=1N){done;}",
            &expect![[r#"
                module M(
                    a: Number in ..5 = 3,
                    b: Number in 1.. = 3,
                    c: Text in "a" | "b",
                    d: Force in -1 N..2 N = 1 N
                ) {
                    done;
                }
            "#]],
        );
    }

    #[test]
    fn the_environment_of_a_program_has_one_shape() {
        check(
            "module M(host){exec \"m\";env { A=\"a\";B = \"b\" ; } inherit LC_ALL,ROS_ * ;directory\"/opt\";done;}",
            &expect![[r#"
                module M(host) { exec "m"; env{A = "a"; B = "b";} inherit LC_ALL, ROS_*; directory "/opt"; done; }
            "#]],
        );
    }

    #[test]
    fn comments_stay_where_they_are() {
        check(
            "// first\nprocess a(){//why\n host{/* h */ c1}\n\n\n // own\n\n internal_event_actions{ a // left\n # b /* x */ ,\n// own\nc } // end\n // last in a\n } // a\n // of b\n process b(){\n}\n// end",
            &expect![[r#"
                // first
                process a(){ //why
                    host{ /* h */ c1}

                    // own

                    internal_event_actions{
                        a # // left
                            b, /* x */
                        // own
                        c
                    } // end
                    // last in a
                } // a

                // of b
                process b(){}
                // end
            "#]],
        );
    }

    #[test]
    fn long_expressions_break_at_the_loosest_operator() {
        check(
            "process p(){internal_event_actions{motionctrl,((visualserv[lbl1]#distdetect);((opengrip,approach[lbl1])#hit);closegrip;presshandle[lbl1];dooropen[lbl1])}}
             process q(){internal_event_actions{ a ;\n b ; (c # d) }}
             process r(){instantiated_processes{some_long_name instof SomeLongType(the_first_argument, \"second argument\", third = 100 m/s);}}",
            &expect![[r#"
                process p(){
                    internal_event_actions{
                        motionctrl, (
                            (visualserv[lbl1] # distdetect) ;
                            ((opengrip, approach[lbl1]) # hit) ;
                            closegrip ;
                            presshandle[lbl1] ;
                            dooropen[lbl1]
                        )
                    }
                }

                process q(){
                    internal_event_actions{
                        a ;
                        b ;
                        (c # d)
                    }
                }

                process r(){
                    instantiated_processes{
                        some_long_name instof SomeLongType(the_first_argument, "second argument", third = 100 m/s);
                    }
                }
            "#]],
        );
    }

    #[test]
    fn what_cannot_be_read_is_left_alone() {
        let found = format(&Source::new("a.dca", "process main( {")).unwrap_err();
        assert_eq!(found[0].code, crate::diagnostic::Code::E0001);
    }
}
