//! The layouts that the Python examples use are those that the compiler made.

#[path = "../examples/python_layouts/layouts.rs"]
mod layouts;

#[test]
fn the_committed_module_is_up_to_date() {
    let committed = include_str!("../../examples/python/upswing_layouts.py");
    let how =
        "cargo run --release -p upswing-ipc --example python_layouts > examples/python/upswing_layouts.py";
    assert!(committed == layouts::module(), "the layouts changed: run `{how}`");
}
