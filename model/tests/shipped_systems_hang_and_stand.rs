//! The systems in `config/systems`: every `robot.urdf` is the chain of joints in the table, hangs and stands where the table says, swings
//! with the natural frequencies of the table, and the inertia of its unactuated joints is regular in the whole range.

mod common;

use common::Random;
use nalgebra::{Cholesky, DMatrix, SymmetricEigen};
use std::path::Path;
use upswing_model::{
    ActuatedVector, JointKind, JointVector, LimitKind, Linearization, Model, State, Urdf, Workspace,
};

const R: JointKind = JointKind::Revolute;
const C: JointKind = JointKind::Continuous;
const P: JointKind = JointKind::Prismatic;

/// What is expected of a system.
struct System {
    /// Folder in `config/systems`.
    name: &'static str,
    /// Actuated joints, in the chain's order.
    actuated: &'static [(&'static str, JointKind)],
    /// Unactuated joints, in the chain's order.
    unactuated: &'static [(&'static str, JointKind)],
    /// Names of all joints in the chain's order, if the unactuated joints are not the last ones.
    chain: Option<&'static str>,
    /// A pose in which the unactuated joints hang: positions other than 0, deg or m.
    hangs: &'static [(&'static str, f64)],
    /// A pose in which they stand upright, if there is one.
    stands: Option<&'static [(&'static str, f64)]>,
    /// Natural frequencies of the unactuated joints where they hang and the actuated ones do not move, rad/s, ascending. Computed with the
    /// textbook formulas of planar chains from the numbers of the sources.
    frequencies: &'static [f64],
    /// Largest ratio of the eigenvalues of M_UU in the range: 1 for one joint, a few for a gimbal, more for links on links.
    condition: f64,
}

const SYSTEMS: [System; 11] = [
    System {
        name: "cart-pole",
        actuated: &[("cart", P)],
        unactuated: &[("pole", C)],
        chain: None,
        hangs: &[("cart", 0.2)],
        stands: Some(&[("cart", -0.2), ("pole", 180.0)]),
        frequencies: &[4.7913],
        condition: 1.001,
    },
    System {
        name: "cart-double",
        actuated: &[("cart", P)],
        unactuated: &[("pole_1", C), ("pole_2", C)],
        chain: None,
        hangs: &[("cart", 0.5)],
        stands: Some(&[("pole_1", 180.0)]),
        frequencies: &[4.2889, 7.9681],
        condition: 25.0,
    },
    System {
        name: "cart-triple",
        actuated: &[("cart", P)],
        unactuated: &[("pole_1", C), ("pole_2", C), ("pole_3", C)],
        chain: None,
        hangs: &[],
        stands: Some(&[("pole_1", 180.0)]),
        frequencies: &[3.5443, 6.6393, 11.9660],
        condition: 200.0,
    },
    System {
        name: "xy-spherical",
        actuated: &[("slide_x", P), ("slide_y", P)],
        unactuated: &[("pendulum_1", C), ("pendulum_2", R)],
        chain: None,
        hangs: &[("slide_x", 0.3), ("slide_y", -0.2)],
        stands: Some(&[("pendulum_1", 180.0)]),
        frequencies: &[4.9502, 4.9523],
        condition: 5.0,
    },
    System {
        name: "furuta",
        actuated: &[("arm", R)],
        unactuated: &[("pendulum", C)],
        chain: None,
        hangs: &[("arm", 50.0)],
        stands: Some(&[("arm", -70.0), ("pendulum", 180.0)]),
        frequencies: &[10.6803],
        condition: 1.001,
    },
    System {
        name: "acrobot",
        actuated: &[("elbow", R)],
        unactuated: &[("shoulder", C)],
        chain: Some("shoulder elbow"),
        hangs: &[],
        stands: Some(&[("shoulder", 180.0)]),
        frequencies: &[4.7181],
        condition: 1.001,
    },
    System {
        name: "pendubot",
        actuated: &[("shoulder", R)],
        unactuated: &[("elbow", C)],
        chain: None,
        hangs: &[],
        stands: Some(&[("shoulder", 180.0)]),
        frequencies: &[5.5539],
        condition: 1.001,
    },
    System {
        name: "gantry-crane",
        actuated: &[("bridge", P), ("trolley", P), ("hoist", P)],
        unactuated: &[("sway_x", R), ("sway_y", R)],
        chain: Some("bridge trolley sway_x sway_y hoist"),
        hangs: &[("bridge", 1.5), ("trolley", -0.5), ("hoist", 1.0)],
        stands: None,
        frequencies: &[2.9857, 2.9857],
        condition: 5.0,
    },
    System {
        name: "kr3-single",
        actuated: &[
            ("joint_1", R),
            ("joint_2", R),
            ("joint_3", R),
            ("joint_4", R),
            ("joint_5", R),
            ("joint_6", R),
        ],
        unactuated: &[("pendulum", C)],
        chain: None,
        hangs: &[
            ("joint_1", 30.0),
            ("joint_2", -100.0),
            ("joint_3", 120.0),
            ("joint_5", -20.0),
            ("joint_6", 40.0),
            ("pendulum", 40.0),
        ],
        stands: Some(&[("joint_2", -80.0), ("joint_3", 70.0), ("joint_5", 10.0), ("pendulum", 180.0)]),
        frequencies: &[6.0643],
        condition: 1.001,
    },
    System {
        name: "ur5e-pendulum",
        actuated: &[
            ("shoulder_pan", R),
            ("shoulder_lift", R),
            ("elbow", R),
            ("wrist_1", R),
            ("wrist_2", R),
            ("wrist_3", R),
        ],
        unactuated: &[("pendulum_1", C), ("pendulum_2", R)],
        chain: None,
        hangs: &[
            ("shoulder_pan", 20.0),
            ("shoulder_lift", -70.0),
            ("elbow", 100.0),
            ("wrist_1", -30.0),
            ("wrist_2", 90.0),
            ("wrist_3", 40.0),
            ("pendulum_1", -40.0),
        ],
        stands: Some(&[
            ("shoulder_lift", -90.0),
            ("elbow", 80.0),
            ("wrist_1", 10.0),
            ("wrist_2", 90.0),
            ("pendulum_1", 180.0),
        ]),
        frequencies: &[5.4002, 5.4260],
        condition: 5.0,
    },
    System {
        name: "franka-pendulum",
        actuated: &[
            ("joint_1", R),
            ("joint_2", R),
            ("joint_3", R),
            ("joint_4", R),
            ("joint_5", R),
            ("joint_6", R),
            ("joint_7", R),
        ],
        unactuated: &[("pendulum_1", C), ("pendulum_2", R)],
        chain: None,
        hangs: &[
            ("joint_1", 20.0),
            ("joint_2", -20.0),
            ("joint_4", -120.0),
            ("joint_6", 190.0),
            ("joint_7", 40.0),
            ("pendulum_1", -40.0),
        ],
        stands: Some(&[("joint_2", 10.0), ("joint_4", -100.0), ("joint_6", 200.0), ("pendulum_1", 180.0)]),
        frequencies: &[5.4002, 5.4260],
        condition: 5.0,
    },
];

/// The model in the `robot.urdf` of the folder `name`; the text gives no warning.
fn load(name: &str) -> Model {
    let path = folder().join(name).join("robot.urdf");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let urdf = Urdf::read(&text).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert_eq!(urdf.warnings, Vec::<String>::new(), "{name}");
    Model::from_description(&urdf).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn folder() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../config/systems"))
}

/// The positions of all joints, rad or m, from those of some, deg or m; the others are 0.
fn pose(model: &Model, shown: &[(&str, f64)]) -> JointVector {
    let mut q = JointVector::zeros(model.sizes());
    for (name, value) in shown {
        let c = model.coordinate(name).unwrap_or_else(|| panic!("no joint `{name}`"));
        q[c] = model.joint_kind(c).position(*value);
        let range = model.rated_limits().range(LimitKind::Position, c);
        assert!(range.0 <= q[c] && q[c] <= range.1, "{name} = {value} is outside its range");
    }
    q
}

/// M_UU and the curvature of the potential energy in q_U.
fn inertia_and_curvature(model: &Model, q: &JointVector) -> (DMatrix<f64>, DMatrix<f64>) {
    const STEP: f64 = 1e-5;
    let mut work = Workspace::default();
    let (a, u) = (model.sizes().actuated(), model.sizes().unactuated());
    let m = model.mass_matrix(q, &mut work);
    let mut gravity = |c: usize, by: f64| {
        let mut moved = *q;
        moved[a + c] += by;
        model.gravity_torque(&moved, &mut work)
    };
    let columns: Vec<_> = (0..u).map(|c| (gravity(c, STEP), gravity(c, -STEP))).collect();
    (
        DMatrix::from_fn(u, u, |i, j| m.row(a + i)[a + j]),
        DMatrix::from_fn(u, u, |i, j| (columns[j].0[a + i] - columns[j].1[a + i]) / (2.0 * STEP)),
    )
}

/// Eigenvalues of M_UU^-1 K, 1/s^2, ascending.
fn squared_frequencies(model: &Model, q: &JointVector) -> Vec<f64> {
    let (m, k) = inertia_and_curvature(model, q);
    let inverse = Cholesky::new(m).expect("M_UU is positive definite").l().try_inverse().expect("regular");
    let scaled = &inverse * (0.5 * (&k + k.transpose())) * inverse.transpose();
    let mut squares: Vec<f64> = SymmetricEigen::new(scaled).eigenvalues.iter().copied().collect();
    squares.sort_by(f64::total_cmp);
    squares
}

#[test]
fn every_folder_has_a_row() {
    let mut folders: Vec<String> = std::fs::read_dir(folder())
        .expect("config/systems")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("a name"))
        // The paper's robot has tests of its own.
        .filter(|name| name != "iiwa-pendulum")
        .collect();
    folders.sort();
    let mut rows = SYSTEMS.map(|system| system.name);
    rows.sort_unstable();
    assert_eq!(folders, rows);
}

#[test]
fn joints_are_those_of_the_table() {
    for system in &SYSTEMS {
        let model = load(system.name);
        let sizes = model.sizes();
        assert_eq!(
            (sizes.actuated(), sizes.unactuated()),
            (system.actuated.len(), system.unactuated.len()),
            "{}",
            system.name
        );
        for (c, (name, kind)) in system.actuated.iter().chain(system.unactuated).enumerate() {
            assert_eq!((model.joint_name(c), model.joint_kind(c)), (*name, *kind), "{}", system.name);
        }
        let chain = system.chain.map_or_else(
            || system.actuated.iter().chain(system.unactuated).map(|(name, _)| *name).collect(),
            |chain| chain.split(' ').collect::<Vec<_>>(),
        );
        assert_eq!(model.joint_names().collect::<Vec<_>>(), chain, "{}", system.name);
    }
}

#[test]
fn hangs_at_rest_and_swings_with_its_natural_frequencies() {
    for system in &SYSTEMS {
        let model = load(system.name);
        let mut work = Workspace::default();
        let hanging = pose(&model, system.hangs);
        let mut moved = hanging;
        moved.unactuated_mut().iter_mut().for_each(|q| *q += 0.3);
        let rest = model.rest_position(&moved, &mut work).unwrap_or_else(|e| panic!("{}: {e}", system.name));
        for c in 0..model.sizes().joints() {
            assert!(
                (rest[c] - hanging[c]).abs() < 1e-9,
                "{}: `{}` rests at {}, expected {}",
                system.name,
                model.joint_name(c),
                rest[c],
                hanging[c]
            );
        }
        let at_rest = State::new(&hanging, &JointVector::zeros(model.sizes()));
        model.check_equilibrium(&at_rest, &mut work).unwrap_or_else(|e| panic!("{}: {e}", system.name));
        let frequencies: Vec<f64> = squared_frequencies(&model, &hanging).iter().map(|v| v.sqrt()).collect();
        println!("{}: {frequencies:.4?} rad/s", system.name);
        assert_eq!(frequencies.len(), system.frequencies.len(), "{}", system.name);
        for (got, want) in frequencies.iter().zip(system.frequencies) {
            assert!((got / want - 1.0).abs() < 1e-3, "{}: {frequencies:?}", system.name);
        }
    }
}

#[test]
fn stands_upright_where_every_direction_is_down() {
    for system in &SYSTEMS {
        let Some(stands) = system.stands else { continue };
        let model = load(system.name);
        let q = pose(&model, stands);
        let standing = State::new(&q, &JointVector::zeros(model.sizes()));
        model
            .check_equilibrium(&standing, &mut Workspace::default())
            .unwrap_or_else(|e| panic!("{}: {e}", system.name));
        let squares = squared_frequencies(&model, &q);
        println!(
            "{}: poles {:.4?} 1/s",
            system.name,
            squares.iter().map(|v| (-v).sqrt()).collect::<Vec<_>>()
        );
        assert!(squares.iter().all(|square| *square < -1.0), "{}: {squares:?}", system.name);
    }
}

/// Hautus' criterion: a pole p of A can be moved by u if [A - p I, B] has full rank.
#[test]
fn the_actuated_joints_can_balance() {
    for system in &SYSTEMS {
        let Some(stands) = system.stands else { continue };
        let model = load(system.name);
        let sizes = model.sizes();
        let q = pose(&model, stands);
        let standing = State::new(&q, &JointVector::zeros(sizes));
        let mut derivatives = Linearization::new(sizes);
        model.linearize(
            standing.as_slice(),
            ActuatedVector::zeros(sizes).as_slice(),
            &mut Workspace::default(),
            &mut derivatives,
        );
        let (a, b) = (derivatives.a(), derivatives.b());
        for square in squared_frequencies(&model, &q) {
            let pole = (-square).sqrt();
            let n = 2 * sizes.joints();
            let mut hautus = DMatrix::zeros(n, n + sizes.actuated());
            hautus.view_mut((0, 0), (n, n)).copy_from(&(&a - DMatrix::identity(n, n) * pole));
            hautus.view_mut((0, n), (n, sizes.actuated())).copy_from(&b);
            let smallest = hautus.singular_values().min();
            println!("{}: pole {pole:.3} 1/s, {smallest:.4}", system.name);
            assert!(smallest > 0.01, "{}: pole {pole}, {smallest}", system.name);
        }
    }
}

#[test]
fn inertia_of_the_unactuated_joints_is_regular_in_the_range() {
    for system in &SYSTEMS {
        let model = load(system.name);
        let limits = model.rated_limits().scale();
        let mut random = Random(7);
        let mut worst = 0.0_f64;
        for _ in 0..5000 {
            let q = JointVector::from_fn(model.sizes(), |c| {
                let (min, max) = (limits.q_min[c], limits.q_max[c]);
                min + (max - min) * (0.5 + 0.5 * random.number())
            });
            let eigenvalues = inertia_and_curvature(&model, &q).0.symmetric_eigenvalues();
            assert!(eigenvalues.min() > 0.0, "{}", system.name);
            worst = worst.max(eigenvalues.max() / eigenvalues.min());
        }
        println!("{}: condition {worst:.2}", system.name);
        assert!(worst <= system.condition, "{}: condition {worst}", system.name);
    }
}
