//! Views for an operator: a running system in the terminal ([`monitor`]), in a browser ([`web`]) and as metrics ([`metrics`]), all
//! three from one [`live`] client; a recording as a page ([`page`]) and as pictures ([`picture`]).

pub mod http;
pub mod live;
pub mod metrics;
pub mod monitor;
pub mod page;
pub mod picture;
mod requests;
pub mod web;
