//! The derive macros of the SDK: `#[derive(Inputs)]` and `#[derive(Outputs)]` on a struct of ports.
//!
//! A proc macro rather than a macro by example: attributes, doc comments and visibility work as in
//! any struct, and an error points at the wrong field, attribute or word. `ports` reads the struct,
//! `expand` writes the code.

mod expand;
mod ports;

use proc_macro::TokenStream;
use syn::{DeriveInput, parse_macro_input};

/// Makes a struct the inputs of a controller.
///
/// Each field is an `In<T>` with one attribute: `#[port("In")]` is wired by a spec, `#[port("In", optional)]` may stay
/// unconnected, `#[device("arm/state")]` receives from a device, `#[device("arm/cmd", owner)]` is the side of the program that owns
/// the device. A doc comment of a field becomes part of the interface.
#[proc_macro_derive(Inputs, attributes(port, device))]
pub fn inputs(input: TokenStream) -> TokenStream {
    derive(&parse_macro_input!(input as DeriveInput), ports::Direction::In).into()
}

/// Makes a struct the outputs of a controller.
///
/// Each field is an `Out<T>` with one attribute: `#[port("Out")]`, `#[port("Out", optional)]`, `#[device("arm/cmd")]` to
/// command a device, `#[device("arm/state", owner)]` for the program that owns the device. A field `Calls<A, R>` with
/// `#[calls("Grip")]` or `#[calls("Grip", optional)]` calls what another process exports. A field `Database` with `#[database]` is the
/// database of the robot.
#[proc_macro_derive(Outputs, attributes(port, device, calls, database))]
pub fn outputs(input: TokenStream) -> TokenStream {
    derive(&parse_macro_input!(input as DeriveInput), ports::Direction::Out).into()
}

fn derive(input: &DeriveInput, direction: ports::Direction) -> proc_macro2::TokenStream {
    match ports::read(input, direction) {
        Ok(ports) => expand::ports(input, direction, Some(&ports)),
        // The impl is still written, so that a mistake in one field is the only error.
        Err(error) => {
            let (errors, rest) = (error.to_compile_error(), expand::ports(input, direction, None));
            quote::quote! { #errors #rest }
        }
    }
}
