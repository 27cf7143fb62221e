//! The code of the derive macros.

use crate::ports::{Binding, Direction, Port};
use proc_macro2::TokenStream;
use quote::{format_ident, quote, quote_spanned};
use syn::DeriveInput;

/// Writes the impl of a set of ports; without them, since they could not be read, one that is never run.
pub(crate) fn ports(input: &DeriveInput, direction: Direction, read: Option<&[Port<'_>]>) -> TokenStream {
    let ports = read.unwrap_or_default();
    let sdk = quote!(::controllers::sdk);
    let (set, one, any, way) = match direction {
        Direction::In => ("InputSet", "InputPort", "AnyIn", "In"),
        Direction::Out => ("OutputSet", "OutputPort", "AnyOut", "Out"),
    };
    let [set, one, any, way] = [set, one, any, way].map(|name| format_ident!("{name}"));
    let declared = ports.iter().map(|port| {
        let (ty, name, doc) = (port.ty, &port.name, &port.doc);
        let kind = format_ident!("{}", kind(port.binding));
        // A type that is no port is an error at the field's type.
        let message = quote_spanned!(port.type_span()=> <#ty as #sdk::#one>::Message);
        quote! {
            #sdk::PortInterface::#kind(#name, #sdk::Direction::#way, <#message as #sdk::Message>::TYPE)
                .carrying(<#message as #sdk::Message>::FIELDS)
                .documented(#doc)
        }
    });
    let visited = ports.iter().zip(0usize..).map(|(port, index)| {
        let field = port.field;
        quote!(visit(#index, &mut self.#field);)
    });
    let made = ports.iter().map(|port| {
        let field = port.field;
        quote_spanned!(port.type_span()=> #field: ::core::default::Default::default())
    });
    let made = if read.is_some() { quote!(Self { #(#made,)* }) } else { quote!(::core::unreachable!()) };
    let (name, (generics, arguments, bounds)) = (&input.ident, input.generics.split_for_impl());
    quote! {
        #[automatically_derived]
        impl #generics #sdk::#set for #name #arguments #bounds {
            fn unconnected() -> Self {
                #made
            }
            fn declared() -> ::std::vec::Vec<#sdk::PortInterface> {
                ::std::vec![#(#declared,)*]
            }
            fn visit(&mut self, visit: &mut dyn ::core::ops::FnMut(::core::primitive::usize, &mut dyn #sdk::#any)) {
                let _ = &visit;
                #(#visited)*
            }
        }
    }
}

/// The function that makes the interface of such a port.
fn kind(binding: Binding) -> &'static str {
    match binding {
        Binding::Wire => "wire",
        Binding::Optional => "optional",
        Binding::Client => "device",
        Binding::Owner => "owner",
    }
}
