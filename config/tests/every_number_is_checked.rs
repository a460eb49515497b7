//! No number of any settings file is used unchecked: each one is refused as NaN, and each whole one as far below 0 as can be.

mod common;
use common::exported;
use toml::{Table, Value};
use upswing_config::Config;

/// Replaces one number of a value after the other, in a file that `rebuild` makes of it: how many there are, and in `accepted`
/// the places of those with which it `loads`.
fn replace(
    value: &Value,
    place: &str,
    loads: &dyn Fn(&Value) -> bool,
    accepted: &mut Vec<String>,
    rebuild: &dyn Fn(Value) -> Value,
) -> usize {
    let bad = match value {
        Value::Float(_) => vec![Value::Float(f64::NAN)],
        Value::Integer(_) => vec![Value::Float(f64::NAN), Value::Integer(i64::MIN)],
        Value::Array(items) => {
            let whole = items.clone();
            let each = |(i, item): (usize, &Value)| {
                let rebuild = |new: Value| {
                    let mut items = whole.clone();
                    items[i] = new;
                    rebuild(Value::Array(items))
                };
                replace(item, &format!("{place}[{i}]"), loads, accepted, &rebuild)
            };
            return items.iter().enumerate().map(each).sum();
        }
        Value::Table(table) => {
            let whole = table.clone();
            let each = |(key, item): (&String, &Value)| {
                let rebuild = |new: Value| {
                    let mut table = whole.clone();
                    table.insert(key.clone(), new);
                    rebuild(Value::Table(table))
                };
                replace(item, &format!("{place}.{key}"), loads, accepted, &rebuild)
            };
            return table.iter().map(each).sum();
        }
        _ => return 0,
    };
    for bad in bad {
        let name = format!("{place} = {bad}");
        if loads(&rebuild(bad)) {
            accepted.push(name);
        }
    }
    1
}

#[test]
fn by_its_rule() {
    let dir = exported();
    let (mut accepted, mut numbers) = (Vec::new(), 0);
    for file in ["robot.toml", "planner.toml", "daemon.toml", "plant.toml", "manoeuvres.toml"] {
        let path = dir.path().join(file);
        let original = std::fs::read_to_string(&path).expect("exported");
        let table: Table = original.parse().expect("TOML");
        let loads = |value: &Value| {
            std::fs::write(&path, toml::to_string(value).expect("TOML")).expect("written");
            Config::from_dir(dir.path()).is_ok()
        };
        let whole = Value::Table(table);
        assert!(loads(&whole), "{file} as it is");
        numbers += replace(&whole, file, &loads, &mut accepted, &|value| value);
        std::fs::write(&path, original).expect("written");
    }
    assert!(numbers > 100, "only {numbers} numbers");
    // Any finite number will do for these: biases and offsets of a simulated plant, coefficients of a target, a place on its flange.
    accepted.retain(|name| {
        !["bias", "offset", "position_m", "start.q_m", "coefficients"].iter().any(|free| name.contains(free))
            || name.contains("nan")
    });
    assert_eq!(accepted, Vec::<String>::new());
}
