//! The kinds of tokens and nodes.

macro_rules! kinds {
    ({ $($name:ident $what:literal)* } operators { $($operator:ident $written:literal)* }) => {
        /// The kind of a token or a node of the syntax tree.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u16)]
        pub enum SyntaxKind {
            $(#[doc = $what] $name,)*
            $(#[doc = $written] $operator,)*
        }

        /// An event action, named after its operator, or after its kind if it has no operator.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum Operator {
            $(#[doc = $written] $operator,)*
        }

        impl SyntaxKind {
            /// Every kind, in the order of its number.
            pub(crate) const ALL: &'static [Self] = &[$(Self::$name,)* $(Self::$operator,)*];

            /// Every kind of event action.
            #[cfg(test)]
            pub(crate) const OPERATORS: &'static [Self] = &[$(Self::$operator,)*];

            /// Returns the name that people use for it.
            pub fn describe(self) -> &'static str {
                match self {
                    $(Self::$name => $what,)*
                    $(Self::$operator => $written,)*
                }
            }

            /// Returns the kind of event action of a node. Nothing if the node is not an event action.
            pub(crate) fn operator(self) -> Option<Operator> {
                match self {
                    $(Self::$name => None,)*
                    $(Self::$operator => Some(Operator::$operator),)*
                }
            }

            /// Returns whether it carries no meaning for the parser.
            pub fn is_trivia(self) -> bool {
                matches!(self, Self::Whitespace | Self::Comment | Self::DocComment)
            }
        }
    };
}

kinds! {
    {
        // tokens
        Whitespace "white space"
        Comment "a comment"
        DocComment "a doc comment"
        Ident "a name"
        Number "a number"
        Text "a string"
        Script "the text of a script"
        LeftParen "`(`"
        RightParen "`)`"
        LeftBrace "`{`"
        RightBrace "`}`"
        LeftBracket "`[`"
        RightBracket "`]`"
        Less "`<`"
        Greater "`>`"
        Comma "`,`"
        Semicolon "`;`"
        Colon "`:`"
        Dot "`.`"
        DotDot "`..`"
        Hash "`#`"
        Ampersand "`&`"
        Question "`?`"
        Equals "`=`"
        Bar "`|`"
        Slash "`/`"
        Minus "`-`"
        Star "`*`"
        Plus "`+`"
        Bang "`!`"
        Arrow "`->`"
        BackArrow "`<-`"
        FatArrow "`=>`"
        Recur "`;;`"
        DoubleColon "`::`"
        Unknown "a character that means nothing here"
        End "the end of the file"
        // nodes: files and groups
        File "a file"
        Process "a process group"
        Module "a module interface"
        ConstItem "a named constant"
        TypeItem "a named type"
        Use "a use of another file"
        Params "parameters"
        Param "a parameter"
        Type "a type"
        RecordType "the fields of a record"
        Range "the values of a parameter"
        Host "a host section"
        Instances "a section of instances"
        Instance "an instance"
        Policies "policies"
        Policy "a policy"
        Supervision "a section of supervision"
        OnBoot "what a reboot does"
        Count "how many"
        Index "an index"
        List "a list"
        Args "arguments"
        Arg "an argument"
        Constant "a constant"
        Record "a record"
        Secret "a secret"
        Field "a field"
        External "a section of external ports"
        Export "an external port"
        Connections "a connection set"
        Owner "the owner of a connection set"
        Connection "a connection"
        Endpoint "an end of a connection"
        Keys "keys of the database"
        Topic "a topic or a service of ROS 2"
        TopicQuality "the quality of service of a topic"
        FramePrefix "the prefix of the frames of a topic"
        Quality "a connection quality"
        Actions "an event-action section"
        Resources "resources"
        Verify "properties"
        Sentence "a property"
        // nodes: module items
        Port "a port"
        Exec "a program"
        Environment "variables of a program"
        Variable "a variable"
        Inherit "inherited variables"
        Inherited "an inherited variable"
        Folder "the folder of a program"
        Python "a Python program"
        RosAction "an action of ROS 2"
        RosProgram "a program of ROS 2"
        RosSetup "a setup file of ROS 2"
        RosName "the name of a node of ROS 2"
        RosRemap "another name for a name of ROS 2"
        RosParams "a file of parameters of ROS 2"
        RosComponents "the components of a container of ROS 2"
        RosComponent "a component of ROS 2"
        Lifecycle "the lifecycle of a node of ROS 2"
        Venv "a virtual environment of Python"
        StopWithin "a stop limit"
        Takes "how long a module takes"
        Flag "a module property"
        Init "the start value of a module"
        Claims "claims"
        Claim "a claim"
        Outcome "an outcome"
        Called "what a procedure is called with"
        // nodes: activities
        StateVariable "a variable of an activity"
        Domain "the values of a variable"
        State "a state"
        StateRun "the run of a state"
        Transition "a transition"
        Trigger "a trigger"
        Asking "a question"
        Choice "an answer"
        Pattern "a pattern"
        Guard "a condition"
        Target "a target"
        Block "actions of a transition"
        Statement "an action of a transition"
        Formula "a formula"
        // nodes: parts of expressions
        Arm "an arm of `match`"
        Until "the outcomes that end a `repeat`"
        StartValue "a start value"
        Labels "labels"
        Binder "a value name"
        Error "something unreadable"
    }
    operators {
        Concurrent "`,`"
        FailFast "`&`"
        Disable "`#`"
        Sequence "`;`"
        Otherwise "`else`"
        Finally "`finally`"
        Chain "`:`"
        Retry "`retry`"
        Repeat "`repeat`"
        Shield "`shield`"
        Using "`using`"
        Match "`match`"
        Named "a name with `=>`"
        Suffixed "a suffix"
        Paren "parentheses"
        Run "a process"
        Fail "`fail`"
        Wait "`wait`"
        AnyOf "`any`"
        AllOf "`all`"
    }
}
