//! The parameter protocol: the vehicle's settings, listed, read and set.
//!
//! Implements <https://mavlink.io/en/services/parameter.html>, rules P-1 to P-32. It handles PARAM_REQUEST_LIST,
//! PARAM_REQUEST_READ, PARAM_SET and MAV_CMD_PREFLIGHT_STORAGE, and sends PARAM_VALUE, PARAM_ERROR and `_HASH_CHECK`. With `files`,
//! all parameters are also a file. PARAM_EXT is not supported.
//!
//! The stack owns the table with the values. It has a mark for every parameter and link on which the value is pending. So lists,
//! reads and changes need no memory besides one cursor per link. The rest of the service's state is part of the table too: a
//! firmware without parameters does not have it.
//!
//! The declarations are checked by the compiler ([`parameters!`](crate::parameters)), or added at run time ([`RuntimeTable`]).
//! If both declarations and values live elsewhere ([`ParamBackend`]), the stack only has the marks ([`ExternalParams`]).

mod backend;
#[macro_use]
mod details;
mod directory;
mod external;
mod hash;
mod info;
mod links;
mod list;
#[macro_use]
mod macros;
mod packed;
mod refusals;
mod replies;
mod requests;
mod row;
mod runtime;
mod saving;
mod service;
mod state;
mod storage;
mod table;
mod value;
mod vehicle;

#[cfg(test)]
mod tests;

pub use backend::{ParamBackend, ParamUpdate, ParamWrite};
pub use details::{ParamAttributes, ParamDetails, attributes_at, details, system_id};
pub use external::ExternalParams;
#[cfg(feature = "storage")]
pub use external::ExternalService;
pub use info::{MAX_PARAMS, ParamFault, ParamInfo};
pub use row::{Checked, Detailed, Row, is_in_order, position};
pub use runtime::RuntimeTable;
#[cfg(feature = "storage")]
pub(crate) use saving::Replaced;
pub use service::ParamService;
#[cfg(feature = "storage")]
pub(crate) use table::Stored;
pub use table::{NoParams, Param, ParamChange, ParamMemory, ParamTable, ParamValues, TableMut};
pub use value::{ParamEncoding, ParamType};
pub use vehicle::{ParamHash, Parameters};
