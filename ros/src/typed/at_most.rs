//! Lists whose type limits their length.

use super::Field;
use crate::logic::cdr::{CdrError, Reader, Writer};
use serde::Serializer;
use std::ops::Deref;

/// A list of at most `N` elements.
#[derive(Clone, Debug, PartialEq)]
pub struct AtMost<T, const N: usize>(Vec<T>);

impl<T, const N: usize> AtMost<T, N> {
    /// Returns a list of these elements; none for more than `N` elements.
    pub fn new(elements: Vec<T>) -> Option<Self> {
        (elements.len() <= N).then_some(Self(elements))
    }
}

impl<T, const N: usize> Deref for AtMost<T, N> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T: Field, const N: usize> Field for AtMost<T, N> {
    const SIZE_MIN: usize = 4;

    fn zero() -> Self {
        Self(Vec::new())
    }

    fn write(&self, writer: &mut Writer) -> Result<(), CdrError> {
        self.0.write(writer)
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError> {
        let elements = Vec::read(reader)?;
        let count = elements.len();
        Self::new(elements).ok_or(CdrError::Long(count))
    }

    fn show<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.show(serializer)
    }
}
