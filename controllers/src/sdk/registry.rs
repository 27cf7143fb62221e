//! Controller types by name.

use super::arguments::{ArgumentError, Arguments};
use super::controller::Controller;
use super::group::{GroupError, InProcessGroup};
use super::interface::Interface;
use super::module::{Instance, Module, interface};
use std::collections::BTreeMap;
use thiserror::Error;

/// Every controller type that a program can run, by its name in specs.
#[derive(Default)]
pub struct Registry {
    types: BTreeMap<&'static str, Entry>,
    /// The fields of record types that occur in lists, by the names of the types.
    inner_types: BTreeMap<String, String>,
}

/// Makes an instance from its arguments, or returns the reason why it cannot.
type Create = dyn Fn(&Arguments) -> Result<Box<dyn Module>, String> + Send + Sync;

struct Entry {
    interface: Interface,
    create: Box<Create>,
}

/// Why an instance could not be made.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CreateError {
    /// There is no such type.
    #[error("unknown controller type `{type_name}`; the known types are {}", .known.join(", "))]
    UnknownType {
        /// The given name.
        type_name: String,
        /// The known types.
        known: Vec<&'static str>,
    },
    /// An argument is wrong.
    #[error("`{type_name}`: {cause}")]
    Argument {
        /// The type.
        type_name: &'static str,
        /// The reason.
        cause: ArgumentError,
    },
    /// The controller refuses its arguments.
    #[error("`{type_name}`: {reason}")]
    Refused {
        /// The type.
        type_name: &'static str,
        /// The reason that the controller gives.
        reason: String,
    },
}

impl std::fmt::Debug for Registry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_set().entries(self.types.keys()).finish()
    }
}

impl Registry {
    /// Adds a controller type; a type with the same name is replaced.
    pub fn add<C: Controller>(&mut self) -> &mut Self {
        let create = |arguments: &Arguments| {
            let controller = C::new(arguments)?;
            Ok(Box::new(Instance::new(controller)) as Box<dyn Module>)
        };
        self.types.insert(C::TYPE, Entry { interface: interface::<C>(), create: Box::new(create) });
        self
    }

    /// Adds a type that is not a [`Controller`] of Rust, such as a class of another language, or a stand-in for a
    /// controller of another program. A type with the same name is replaced. `create` makes an instance, or says in one
    /// line what is wrong with the arguments.
    pub fn add_module(
        &mut self,
        interface: Interface,
        create: impl Fn(&Interface, &Arguments) -> Result<Box<dyn Module>, String> + Send + Sync + 'static,
    ) -> &mut Self {
        let (type_name, own) = (interface.type_name, interface.clone());
        let create = move |arguments: &Arguments| create(&own, arguments);
        self.types.insert(type_name, Entry { interface, create: Box::new(create) });
        self
    }

    /// Adds a record type that occurs in lists of messages: `x: Length, y: Length`.
    pub fn add_type(&mut self, name: &str, fields: &str) -> &mut Self {
        self.inner_types.insert(name.to_owned(), fields.to_owned());
        self
    }

    /// Adds a group of controllers that share a process and a loop, see [`InProcessGroup`]; a type of the same name is replaced.
    ///
    /// # Errors
    /// If its members or wires do not fit.
    pub fn add_group(&mut self, group: InProcessGroup) -> Result<&mut Self, GroupError> {
        let (interface, create) = group.checked()?;
        self.types.insert(interface.type_name, Entry { interface, create });
        Ok(self)
    }

    /// Returns the interface of a type.
    pub fn interface(&self, type_name: &str) -> Option<&Interface> {
        self.types.get(type_name).map(|entry| &entry.interface)
    }

    /// Returns all interfaces, by name.
    pub fn interfaces(&self) -> impl Iterator<Item = &Interface> {
        self.types.values().map(|entry| &entry.interface)
    }

    /// Returns all interfaces as `module` blocks of the `.dca` language, after the types of their messages.
    pub fn interface_text(&self) -> String {
        let inner = self.inner_types.iter().map(|(name, fields)| (name.as_str(), fields.as_str()));
        let messages: BTreeMap<&str, &str> = inner.chain(self.interfaces().flat_map(Interface::messages)).collect();
        let types: String = messages.iter().map(|(name, fields)| format!("type {name} = {{ {fields} }};\n")).collect();
        let modules = self.interfaces().map(Interface::text);
        std::iter::once(types).filter(|types| !types.is_empty()).chain(modules).collect::<Vec<_>>().join("\n")
    }

    /// Makes an instance that is not active; `given` are its arguments after the host, each `value` or `name=value`.
    ///
    /// # Errors
    /// If there is no such type, or the arguments do not fit it.
    pub fn create(&self, type_name: &str, given: &[&str]) -> Result<Box<dyn Module>, CreateError> {
        self.create_at("", "", type_name, given)
    }

    /// Makes an instance that is not active, for the process with this deployment and path.
    ///
    /// # Errors
    /// As in [`Registry::create`].
    pub fn create_at<S: AsRef<str>>(
        &self,
        deployment: &str,
        instance: &str,
        type_name: &str,
        given: &[S],
    ) -> Result<Box<dyn Module>, CreateError> {
        let (&type_name, entry) = self.types.get_key_value(type_name).ok_or_else(|| CreateError::UnknownType {
            type_name: type_name.to_owned(),
            known: self.types.keys().copied().collect(),
        })?;
        let arguments = Arguments::parse(entry.interface.about.parameters, given)
            .map_err(|cause| CreateError::Argument { type_name, cause })?;
        (entry.create)(&arguments.of(deployment, instance)).map_err(|reason| CreateError::Refused { type_name, reason })
    }
}
