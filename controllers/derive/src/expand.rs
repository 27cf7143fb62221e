//! The code of the derive macros.

use crate::ports::{Binding, Direction, Port};
use proc_macro2::TokenStream;
use quote::{format_ident, quote, quote_spanned};
use syn::DeriveInput;

/// Writes the impl of a set of ports. If the ports could not be read, the impl is never run.
pub(crate) fn ports(input: &DeriveInput, direction: Direction, read: Option<&[Port<'_>]>) -> TokenStream {
    let ports = read.unwrap_or_default();
    let sdk = quote!(::controllers::sdk);
    let (set, one, any, way) = match direction {
        Direction::In => ("InputSet", "InputPort", "AnyIn", "In"),
        Direction::Out => ("OutputSet", "OutputPort", "AnyOut", "Out"),
    };
    let [set, one, any, way] = [set, one, any, way].map(|name| format_ident!("{name}"));
    let database = ports.iter().find(|port| port.binding == Binding::Database).map(|port| database(port, &sdk));
    let wired = ports.iter().filter(|port| port.binding != Binding::Database);
    let (calls, data): (Vec<&Port<'_>>, Vec<&Port<'_>>) = wired.partition(|port| port.is_call());
    let declared = data.iter().map(|port| {
        let (ty, name, doc) = (port.ty, &port.name, &port.doc);
        let kind = format_ident!("{}", kind(port.binding));
        // A type that is not a port is an error at the field's type.
        let message = quote_spanned!(port.type_span()=> <#ty as #sdk::#one>::Message);
        quote! {
            #sdk::PortInterface::#kind(#name, #sdk::Direction::#way, <#message as #sdk::Message>::TYPE)
                .carrying(<#message as #sdk::Message>::FIELDS)
                .documented(#doc)
        }
    });
    let visited = data.iter().zip(0usize..).map(|(port, index)| {
        let field = port.field;
        quote!(visit(#index, &mut self.#field);)
    });
    let made = ports.iter().map(|port| {
        let field = port.field;
        quote_spanned!(port.type_span()=> #field: ::core::default::Default::default())
    });
    let made = if read.is_some() { quote!(Self { #(#made,)* }) } else { quote!(::core::unreachable!()) };
    let calls = made_calls(&calls, &sdk);
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
            #calls
            #database
        }
    }
}

/// The part of the impl about the database.
fn database(port: &Port<'_>, sdk: &TokenStream) -> TokenStream {
    let (field, ty) = (port.field, port.ty);
    let access = quote_spanned!(port.type_span()=> <#ty as #sdk::DatabasePort>::database(&mut self.#field));
    quote! {
        fn database(&mut self) -> ::core::option::Option<&mut #sdk::Database> {
            ::core::option::Option::Some(#access)
        }
    }
}

/// The part of the impl about calls; nothing without any.
fn made_calls(calls: &[&Port<'_>], sdk: &TokenStream) -> Option<TokenStream> {
    let declared = calls.iter().map(|port| {
        let (ty, name, doc, required) = (port.ty, &port.name, &port.doc, port.binding == Binding::Calls);
        let argument = quote_spanned!(port.type_span()=> <#ty as #sdk::CallPort>::Argument);
        let result = quote_spanned!(port.type_span()=> <#ty as #sdk::CallPort>::Result);
        quote!(#sdk::CallInterface::new::<#argument, #result>(#name, #doc, #required))
    });
    let visited = calls.iter().zip(0usize..).map(|(port, index)| {
        let field = port.field;
        quote!(visit(#index, &mut self.#field);)
    });
    (!calls.is_empty()).then(|| {
        quote! {
            fn declared_calls() -> ::std::vec::Vec<#sdk::CallInterface> {
                ::std::vec![#(#declared,)*]
            }
            fn visit_calls(&mut self, visit: &mut dyn ::core::ops::FnMut(::core::primitive::usize, &mut dyn #sdk::AnyCalls)) {
                #(#visited)*
            }
        }
    })
}

/// The function that makes the interface of such a port.
fn kind(binding: Binding) -> &'static str {
    match binding {
        Binding::Wire => "wire",
        Binding::Optional => "optional",
        Binding::Client => "device",
        Binding::Owner => "owner",
        // These kinds have separate functions.
        Binding::Calls | Binding::OptionalCalls | Binding::Database => "wire",
    }
}
