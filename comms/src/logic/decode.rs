//! Decodes a value from bytes that can be copied but not borrowed, such as shared memory. Postcard itself reads only
//! slices.
//!
//! Each byte is copied once. Long pieces go directly to their final place: the buffer of a
//! [`Bytes`](super::bytes::Bytes) or of a `String` is filled from the source. So if another program changes the
//! source during the copy, it cannot change a value after its check.
//!
//! Source: the postcard wire format, version 1.

use postcard::{Error, Result};
use serde::de::value::U32Deserializer;
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, MapAccess, SeqAccess, VariantAccess,
    Visitor,
};

/// How many bytes are copied at once, apart from long pieces.
const WINDOW: usize = 4 << 10;

/// Bytes that are read once, from their beginning.
pub trait Source {
    /// Returns how many bytes are left.
    fn left(&self) -> usize;

    /// Appends `size` bytes to `to`. Returns false and copies nothing if fewer bytes are left.
    fn append(&mut self, size: usize, to: &mut Vec<u8>) -> bool;
}

impl Source for &[u8] {
    fn left(&self) -> usize {
        self.len()
    }

    fn append(&mut self, size: usize, to: &mut Vec<u8>) -> bool {
        let Some((piece, rest)) = self.split_at_checked(size) else { return false };
        to.extend_from_slice(piece);
        *self = rest;
        true
    }
}

/// Returns the value at the beginning of a source, like `postcard::from_bytes`.
///
/// # Errors
/// If the bytes do not encode such a value.
pub fn decode_from<T: DeserializeOwned>(source: &mut dyn Source) -> Result<T> {
    T::deserialize(&mut Reader { source, window: Vec::new(), at: 0 })
}

/// Reads a source through a window.
struct Reader<'s> {
    source: &'s mut dyn Source,
    window: Vec<u8>,
    /// The next byte in the window.
    at: usize,
}

impl Reader<'_> {
    /// Returns how many bytes are left.
    fn left(&self) -> usize {
        self.window.len() - self.at + self.source.left()
    }

    #[inline]
    fn byte(&mut self) -> Result<u8> {
        if self.at == self.window.len() {
            self.refill();
        }
        let byte = *self.window.get(self.at).ok_or(Error::DeserializeUnexpectedEnd)?;
        self.at += 1;
        Ok(byte)
    }

    #[cold]
    fn refill(&mut self) {
        self.window.clear();
        self.at = 0;
        self.source.append(self.source.left().min(WINDOW), &mut self.window);
    }

    #[inline]
    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        if let Some(array) = self.window.get(self.at..).and_then(|rest| rest.first_chunk()) {
            self.at += N;
            return Ok(*array);
        }
        let mut array = [0; N];
        for byte in &mut array {
            *byte = self.byte()?;
        }
        Ok(array)
    }

    /// Reads a length and returns that many bytes in a new buffer.
    fn piece(&mut self) -> Result<Vec<u8>> {
        let size = self.length()?;
        if size > self.left() {
            return Err(Error::DeserializeUnexpectedEnd);
        }
        let mut piece = Vec::with_capacity(size);
        let here = self.window.get(self.at..).unwrap_or_default();
        let here = here.get(..size).unwrap_or(here);
        piece.extend_from_slice(here);
        self.at += here.len();
        if self.source.append(size - piece.len(), &mut piece) {
            Ok(piece)
        } else {
            Err(Error::DeserializeUnexpectedEnd)
        }
    }

    fn length(&mut self) -> Result<usize> {
        usize::try_from(self.varint::<64>()?).map_err(|_too_long| Error::DeserializeBadVarint)
    }

    /// Reads a number of `BITS` bits: seven bits per byte, the lowest first. The highest bit of a byte marks that
    /// more bytes follow.
    #[inline]
    fn varint<const BITS: u32>(&mut self) -> Result<u64> {
        let (mut number, bytes) = (0, BITS.div_ceil(7));
        for place in 0..bytes {
            let byte = self.byte()?;
            number |= u64::from(byte & 0x7f) << (7 * place);
            if byte & 0x80 == 0 {
                let is_over = place + 1 == bytes && byte >> (BITS % 7) != 0;
                return if is_over { Err(Error::DeserializeBadVarint) } else { Ok(number) };
            }
        }
        Err(Error::DeserializeBadVarint)
    }

    fn long_varint(&mut self) -> Result<u128> {
        let mut number = 0;
        for place in 0..19 {
            let byte = self.byte()?;
            number |= u128::from(byte & 0x7f) << (7 * place);
            if byte & 0x80 == 0 {
                let is_over = place == 18 && byte >> 2 != 0;
                return if is_over { Err(Error::DeserializeBadVarint) } else { Ok(number) };
            }
        }
        Err(Error::DeserializeBadVarint)
    }

    /// Reads a signed number, with the sign in the lowest bit.
    #[inline]
    fn signed<const BITS: u32>(&mut self) -> Result<i64> {
        let number = self.varint::<BITS>()?;
        Ok((number >> 1).cast_signed() ^ -(number & 1).cast_signed())
    }
}

/// Reads numbers of fixed and of variable length.
macro_rules! numbers {
    ($($name:ident, $visit:ident, |$reader:ident| $number:expr;)*) => {$(
        #[inline]
        fn $name<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
            let $reader = self;
            visitor.$visit($number)
        }
    )*};
}

/// Converts a number that was read with the bits of its type, so that it fits.
fn fitting<A, B: TryFrom<A>>(number: A) -> Result<B> {
    B::try_from(number).map_err(|_too_large| Error::DeserializeBadVarint)
}

impl<'de> Deserializer<'de> for &mut Reader<'_> {
    type Error = Error;

    numbers! {
        deserialize_i8, visit_i8, |reader| reader.byte()?.cast_signed();
        deserialize_i16, visit_i16, |reader| fitting(reader.signed::<16>()?)?;
        deserialize_i32, visit_i32, |reader| fitting(reader.signed::<32>()?)?;
        deserialize_i64, visit_i64, |reader| reader.signed::<64>()?;
        deserialize_u8, visit_u8, |reader| reader.byte()?;
        deserialize_u16, visit_u16, |reader| fitting(reader.varint::<16>()?)?;
        deserialize_u32, visit_u32, |reader| fitting(reader.varint::<32>()?)?;
        deserialize_u64, visit_u64, |reader| reader.varint::<64>()?;
        deserialize_u128, visit_u128, |reader| reader.long_varint()?;
        deserialize_f32, visit_f32, |reader| f32::from_le_bytes(reader.array()?);
        deserialize_f64, visit_f64, |reader| f64::from_le_bytes(reader.array()?);
    }

    fn is_human_readable(&self) -> bool {
        false
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value> {
        Err(Error::WontImplement)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        match self.byte()? {
            0 => visitor.visit_bool(false),
            1 => visitor.visit_bool(true),
            _ => Err(Error::DeserializeBadBool),
        }
    }

    fn deserialize_i128<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        let number = self.long_varint()?;
        visitor.visit_i128((number >> 1).cast_signed() ^ -(number & 1).cast_signed())
    }

    fn deserialize_char<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        let size = self.length()?;
        if size > 4 {
            return Err(Error::DeserializeBadChar);
        }
        let mut bytes = [0; 4];
        for byte in bytes.iter_mut().take(size) {
            *byte = self.byte()?;
        }
        let text = std::str::from_utf8(bytes.get(..size).unwrap_or_default());
        let character = text.ok().and_then(|text| text.chars().next());
        visitor.visit_char(character.ok_or(Error::DeserializeBadChar)?)
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        self.deserialize_string(visitor)
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        visitor.visit_string(String::from_utf8(self.piece()?).map_err(|_no_text| Error::DeserializeBadUtf8)?)
    }

    fn deserialize_bytes<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        visitor.visit_byte_buf(self.piece()?)
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        visitor.visit_byte_buf(self.piece()?)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        match self.byte()? {
            0 => visitor.visit_none(),
            1 => visitor.visit_some(self),
            _ => Err(Error::DeserializeBadOption),
        }
    }

    fn deserialize_unit<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        visitor.visit_unit()
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value> {
        visitor.visit_unit()
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &'static str, visitor: V) -> Result<V::Value> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        let count = self.length()?;
        visitor.visit_seq(Elements { reader: self, count })
    }

    #[inline]
    fn deserialize_tuple<V: Visitor<'de>>(self, count: usize, visitor: V) -> Result<V::Value> {
        visitor.visit_seq(Elements { reader: self, count })
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(self, _: &'static str, count: usize, visitor: V) -> Result<V::Value> {
        self.deserialize_tuple(count, visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        let count = self.length()?;
        visitor.visit_map(Elements { reader: self, count })
    }

    #[inline]
    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value> {
        self.deserialize_tuple(fields.len(), visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value> {
        visitor.visit_enum(self)
    }

    fn deserialize_identifier<V: Visitor<'de>>(self, _: V) -> Result<V::Value> {
        Err(Error::WontImplement)
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value> {
        Err(Error::WontImplement)
    }
}

/// The elements of a sequence, or the entries of a map, with their number.
struct Elements<'r, 's> {
    reader: &'r mut Reader<'s>,
    count: usize,
}

impl<'de> SeqAccess<'de> for Elements<'_, '_> {
    type Error = Error;

    #[inline]
    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>> {
        let Some(left) = self.count.checked_sub(1) else { return Ok(None) };
        self.count = left;
        seed.deserialize(&mut *self.reader).map(Some)
    }

    /// `None` if there are fewer bytes than elements. Then no memory is reserved for them.
    fn size_hint(&self) -> Option<usize> {
        (self.count <= self.reader.left()).then_some(self.count)
    }
}

impl<'de> MapAccess<'de> for Elements<'_, '_> {
    type Error = Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>> {
        self.next_element_seed(seed)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value> {
        seed.deserialize(&mut *self.reader)
    }

    fn size_hint(&self) -> Option<usize> {
        SeqAccess::size_hint(self)
    }
}

impl<'de> EnumAccess<'de> for &mut Reader<'_> {
    type Error = Error;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self)> {
        let number: u32 = fitting(self.varint::<32>()?)?;
        let number: U32Deserializer<Error> = number.into_deserializer();
        Ok((seed.deserialize(number)?, self))
    }
}

impl<'de> VariantAccess<'de> for &mut Reader<'_> {
    type Error = Error;

    fn unit_variant(self) -> Result<()> {
        Ok(())
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value> {
        seed.deserialize(self)
    }

    fn tuple_variant<V: Visitor<'de>>(self, count: usize, visitor: V) -> Result<V::Value> {
        self.deserialize_tuple(count, visitor)
    }

    fn struct_variant<V: Visitor<'de>>(self, fields: &'static [&'static str], visitor: V) -> Result<V::Value> {
        self.deserialize_tuple(fields.len(), visitor)
    }
}

#[cfg(test)]
mod tests {
    use super::super::bytes::Bytes;
    use super::*;
    use proptest::prelude::*;
    use serde::{Deserialize, Serialize};
    use std::collections::BTreeMap;
    use std::fmt::Debug;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    enum Kind {
        Nothing,
        One(i16),
        Two(u16, char),
        Named { long: i64, flag: bool },
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    struct Everything {
        numbers: (i8, i32, i128, u8, u32, u64, u128),
        reals: Vec<f64>,
        short: [f32; 3],
        text: String,
        bytes: Bytes,
        kinds: Vec<Kind>,
        names: BTreeMap<String, Option<u16>>,
        nothing: (),
    }

    fn kind() -> impl Strategy<Value = Kind> {
        prop_oneof![
            Just(Kind::Nothing),
            any::<i16>().prop_map(Kind::One),
            any::<(u16, char)>().prop_map(|(number, character)| Kind::Two(number, character)),
            any::<(i64, bool)>().prop_map(|(long, flag)| Kind::Named { long, flag }),
        ]
    }

    prop_compose! {
        fn everything()(
            numbers: (i8, i32, i128, u8, u32, u64, u128),
            reals in prop::collection::vec(-1e300..1e300_f64, 0..1500),
            short in prop::array::uniform3(-1e30..1e30_f32),
            text: String,
            bytes in prop::collection::vec(any::<u8>(), 0..10_000),
            kinds in prop::collection::vec(kind(), 0..20),
            names: BTreeMap<String, Option<u16>>,
        ) -> Everything {
            Everything { numbers, reals, short, text, bytes: Bytes(bytes), kinds, names, nothing: () }
        }
    }

    fn same<T: DeserializeOwned + Debug + PartialEq>(bytes: &[u8]) {
        assert_eq!(decode_from::<T>(&mut &*bytes), postcard::from_bytes(bytes), "{bytes:?}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn what_postcard_has_written_is_read(value in everything()) {
            let bytes = postcard::to_stdvec(&value).unwrap();
            let mut source = &*bytes;
            prop_assert_eq!(decode_from(&mut source), Ok(value));
        }

        #[test]
        fn a_value_that_is_cut_or_changed_is_read_or_refused_as_postcard_does(
            value in everything(), at: prop::sample::Index, byte: u8,
        ) {
            let mut bytes = postcard::to_stdvec(&value).unwrap();
            let at = at.index(bytes.len());
            same::<Everything>(&bytes[..at]);
            bytes[at] = byte;
            // A float that has become NaN is not equal to itself, so encoded bytes are compared.
            let [ours, theirs] = [decode_from::<Everything>(&mut &*bytes), postcard::from_bytes(&bytes)];
            prop_assert_eq!(format!("{ours:?}"), format!("{theirs:?}"));
        }

        #[test]
        fn any_bytes_are_read_or_refused_as_postcard_does(bytes: Vec<u8>) {
            same::<(bool, Option<Bytes>)>(&bytes);
            same::<Vec<Kind>>(&bytes);
            same::<(i16, i32, i64, i128)>(&bytes);
            same::<(u16, u32, u64, u128)>(&bytes);
            same::<BTreeMap<char, String>>(&bytes);
        }
    }

    #[test]
    fn a_length_without_bytes_makes_no_room() {
        let long = [0xff, 0xff, 0xff, 0xff, 0x0f, 1];
        assert_eq!(decode_from::<Bytes>(&mut &long[..]), Err(Error::DeserializeUnexpectedEnd));
        assert_eq!(decode_from::<Vec<u64>>(&mut &long[..]), Err(Error::DeserializeUnexpectedEnd));
    }
}
