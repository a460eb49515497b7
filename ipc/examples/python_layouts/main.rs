//! Prints the payloads, codes and services of this crate as a Python module of ctypes classes:
//!
//!     cargo run --release -p upswing-ipc --example python_layouts > examples/python/upswing_layouts.py

mod layouts;

fn main() {
    print!("{}", layouts::module());
}
