//! Random values of random types are encoded to the same bytes as Rust types by postcard.

use super::*;
use proptest::prelude::*;
use serde::ser::{Serialize, SerializeSeq, SerializeTuple, Serializer};
use std::convert::Infallible;

/// A value of any layout.
#[derive(Clone, Debug, PartialEq)]
enum Tree {
    Number(f64),
    Truth(bool),
    Text(String),
    Piece(Vec<u8>),
    Record(Vec<Self>),
    /// The elements. The flag is true if the layout has a count, so this is an array.
    List(Vec<Self>, bool),
}

/// Serialises like a Rust struct, array, `Vec` and so on.
impl Serialize for Tree {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Number(number) => serializer.serialize_f64(*number),
            Self::Truth(truth) => serializer.serialize_bool(*truth),
            Self::Text(text) => serializer.serialize_str(text),
            Self::Piece(bytes) => serializer.serialize_bytes(bytes),
            Self::Record(values) | Self::List(values, true) => {
                let mut tuple = serializer.serialize_tuple(values.len())?;
                values.iter().try_for_each(|value| tuple.serialize_element(value))?;
                tuple.end()
            }
            Self::List(values, false) => {
                let mut seq = serializer.serialize_seq(Some(values.len()))?;
                values.iter().try_for_each(|value| seq.serialize_element(value))?;
                seq.end()
            }
        }
    }
}

impl Part for &Tree {
    type Error = Infallible;

    fn leaf(&self, layout: &Layout, writer: &mut Writer<'_>) -> Result<(), Infallible> {
        match self {
            Tree::Number(number) => writer.number(*number),
            Tree::Truth(truth) => writer.truth(*truth),
            Tree::Text(text) => writer.text(text),
            Tree::Piece(bytes) => writer.piece(bytes),
            Tree::Record(_) | Tree::List(..) => panic!("{layout} is not a leaf"),
        }
        Ok(())
    }

    fn field(&self, field: &Field) -> Result<Self, Infallible> {
        let Tree::Record(values) = self else { panic!("{self:?} has no fields") };
        let at: usize = field.name[1..].parse().unwrap();
        Ok(&values[at])
    }

    fn elements(&self, _: &Layout, _: Option<usize>) -> Result<Vec<Self>, Infallible> {
        let Tree::List(values, _) = self else { panic!("{self:?} has no elements") };
        Ok(values.iter().collect())
    }
}

/// Makes trees. It does not know whether a list is an array; only `serde` needs that.
struct Trees;

impl Build for Trees {
    type Value = Tree;

    fn number(&mut self, number: f64) -> Tree {
        Tree::Number(number)
    }
    fn truth(&mut self, truth: bool) -> Tree {
        Tree::Truth(truth)
    }
    fn text(&mut self, text: &str) -> Tree {
        Tree::Text(text.to_owned())
    }
    fn piece(&mut self, of: &str, bytes: &[u8]) -> Option<Tree> {
        (of == "ros.A").then(|| Tree::Piece(bytes.to_vec()))
    }
    fn record(&mut self, fields: &[Field], values: Vec<Tree>) -> Tree {
        assert_eq!(fields.len(), values.len());
        Tree::Record(values)
    }
    fn list(&mut self, elements: Vec<Tree>) -> Tree {
        Tree::List(elements, false)
    }
}

fn without_arrays(tree: Tree) -> Tree {
    match tree {
        Tree::List(values, _) => Tree::List(values.into_iter().map(without_arrays).collect(), false),
        Tree::Record(values) => Tree::Record(values.into_iter().map(without_arrays).collect()),
        leaf @ (Tree::Number(_) | Tree::Truth(_) | Tree::Text(_) | Tree::Piece(_)) => leaf,
    }
}

fn number() -> Layout {
    Layout::Number { of: "Force".to_owned() }
}

fn piece() -> Layout {
    Layout::Piece { of: "ros.A".to_owned() }
}

fn record(layouts: Vec<Layout>) -> Layout {
    let field = |(at, layout)| Field { name: format!("f{at}"), layout };
    Layout::Record(layouts.into_iter().enumerate().map(field).collect())
}

fn layouts() -> impl Strategy<Value = Layout> {
    let leaf = prop_oneof![Just(number()), Just(Layout::Truth), Just(Layout::Text), Just(piece())];
    leaf.prop_recursive(4, 24, 5, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 1..5).prop_map(record),
            (inner, prop::option::of(0_usize..4)).prop_map(|(of, count)| Layout::List { of: Box::new(of), count }),
        ]
    })
}

fn values(layout: &Layout) -> BoxedStrategy<Tree> {
    match layout {
        Layout::Number { .. } => any::<f64>().prop_map(Tree::Number).boxed(),
        Layout::Truth => any::<bool>().prop_map(Tree::Truth).boxed(),
        Layout::Text => any::<String>().prop_map(Tree::Text).boxed(),
        Layout::Piece { .. } => any::<Vec<u8>>().prop_map(Tree::Piece).boxed(),
        Layout::Record(fields) => {
            fields.iter().map(|field| values(&field.layout)).collect::<Vec<_>>().prop_map(Tree::Record).boxed()
        }
        Layout::List { of, count } => {
            let (is_array, counts) = (count.is_some(), count.map_or(0..=4, |count| count..=count));
            prop::collection::vec(values(of), counts).prop_map(move |all| Tree::List(all, is_array)).boxed()
        }
    }
}

fn written(layout: &Layout, tree: &Tree) -> Vec<u8> {
    let mut bytes = Vec::new();
    let Ok(()) = write(layout, &tree, &mut Writer::new(&mut bytes));
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn bytes_are_those_of_rust_types((layout, tree) in layouts().prop_flat_map(|layout| (Just(layout.clone()), values(&layout)))) {
        let bytes = written(&layout, &tree);
        prop_assert_eq!(&bytes, &postcard::to_stdvec(&tree).unwrap());
        let back = read(&layout, &bytes, &mut Trees);
        // The length of a list of empty records or empty arrays cannot be checked against its bytes.
        if let Some(back) = back {
            prop_assert_eq!(written(&layout, &back), bytes);
            prop_assert_eq!(format!("{back:?}"), format!("{:?}", without_arrays(tree)));
        } else {
            let text = layout.to_string();
            prop_assert!(text.contains("[0]"), "{}", text);
        }
    }

    #[test]
    fn any_bytes_are_read_or_refused(layout in layouts(), bytes: Vec<u8>) {
        if let Some(tree) = read(&layout, &bytes, &mut Trees) {
            prop_assert!(written(&layout, &tree).len() <= bytes.len());
        }
    }
}

#[test]
fn nothing_that_is_sent_takes_more_memory_or_time_than_its_length() {
    let list = |of, count| Layout::List { of: Box::new(of), count };
    let empty = || Layout::Record(Vec::new());
    for layout in [list(empty(), None), list(empty(), Some(usize::MAX)), list(number(), None), Layout::Text] {
        let long = [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01];
        assert_eq!(read(&layout, &long, &mut Trees), None);
        assert_eq!(read(&layout, &[0xff; 20], &mut Trees), None);
    }
}

#[test]
fn a_type_is_spelt_as_in_a_spec() {
    let list = |of, count| Layout::List { of: Box::new(of), count };
    let layout = record(vec![list(number(), Some(3)), Layout::Text, record(vec![list(Layout::Truth, None), piece()])]);
    assert_eq!(layout.fields(), "f0: Force[3], f1: Text, f2: { f0: Truth[], f1: ros.A }");
    assert_eq!((list(number(), None).to_string().as_str(), number().fields().as_str()), ("Force[]", ""));
}
