//! The robot and random states for the tests of the model.

use upswing_model::{ActuatedVector, JointVector, Model, Sizes, State};

/// Sizes of the shipped robot: nine joints, seven of them actuated.
#[allow(dead_code)]
pub const SIZES: Sizes = Sizes::new(9, 7).expect("seven actuated and two unactuated joints");

#[allow(dead_code)]
pub fn robot() -> Model {
    Model::from_urdf(include_str!("../../../config/systems/iiwa-pendulum/robot.urdf"))
        .expect("the shipped robot loads")
}

/// A state and input of the golden data, and what two independent implementations computed there.
#[derive(serde::Deserialize)]
#[allow(dead_code)]
pub struct Golden {
    q: Vec<f64>,
    qd: Vec<f64>,
    u: Vec<f64>,
    #[serde(rename = "M")]
    pub m: Vec<Vec<f64>>,
    pub nle: Vec<f64>,
    pub g: Vec<f64>,
    pub f: Vec<f64>,
    #[serde(rename = "A")]
    pub a: Vec<Vec<f64>>,
    #[serde(rename = "B")]
    pub b: Vec<Vec<f64>>,
    pub tau: Vec<f64>,
    pub tau_without_coriolis: Vec<f64>,
}

#[allow(dead_code)]
impl Golden {
    pub fn all() -> Vec<Self> {
        let all: Vec<Self> =
            serde_json::from_str(include_str!("../data/golden.json")).expect("golden data parses");
        assert_eq!(all.len(), 64);
        all
    }

    pub fn q(&self) -> JointVector {
        JointVector::from_slice(SIZES, &self.q).expect("nine joints")
    }

    pub fn qd(&self) -> JointVector {
        JointVector::from_slice(SIZES, &self.qd).expect("nine joints")
    }

    pub fn x(&self) -> State {
        State::new(&self.q(), &self.qd())
    }

    pub fn u(&self) -> ActuatedVector {
        ActuatedVector::from_slice(SIZES, &self.u).expect("seven actuated joints")
    }
}

/// Fails unless `got` and `want` are as many and agree to `tolerance`, relative to the larger of 1 and |want|.
#[allow(dead_code)]
pub fn assert_close(
    what: &str,
    got: impl IntoIterator<Item = f64>,
    want: impl IntoIterator<Item = f64>,
    tolerance: f64,
) {
    let (got, want): (Vec<f64>, Vec<f64>) = (got.into_iter().collect(), want.into_iter().collect());
    assert_eq!(got.len(), want.len(), "{what}");
    for (i, (g, w)) in got.into_iter().zip(want).enumerate() {
        assert!((g - w).abs() <= tolerance * w.abs().max(1.0), "{what}[{i}]: got {g}, expected {w}");
    }
}

/// Numbers in [-1, 1): the splitmix64 generator.
#[allow(dead_code)]
pub struct Random(pub u64);

#[allow(dead_code)]
impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn number(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    pub fn vector(&mut self, length: usize) -> Vec<f64> {
        (0..length).map(|_| self.number()).collect()
    }
}

/// A chain of `n` joints, `unactuated` of them without a motor and anywhere in the chain: random kinds, axes, frames and bodies, with
/// rotors.
#[allow(dead_code)]
pub fn random_chain(random: &mut Random, n: usize, unactuated: usize) -> Model {
    let mut effort = vec!["100"; n];
    let mut left = unactuated;
    while left > 0 {
        let i = random.below(n);
        if effort[i] != "0" {
            effort[i] = "0";
            left -= 1;
        }
    }
    let mut text = "<robot name=\"random\"><link name=\"body_0\"/>".to_owned();
    for (i, effort) in effort.iter().enumerate() {
        let mut three = |scale: f64| {
            let [a, b, c] = std::array::from_fn(|_| scale * random.number());
            format!("{a} {b} {c}")
        };
        let (xyz, rpy, com, axis) = (three(0.5), three(3.0), three(0.3), three(1.0));
        let axis = match random.below(6) {
            0 => "1 0 0",
            1 => "0 1 0",
            2 => "0 0 1",
            _ => &axis,
        };
        let kind = ["revolute", "continuous", "prismatic"][random.below(3)];
        let a = nalgebra::Matrix3::from_fn(|_, _| 0.3 * random.number());
        let inertia = a * a.transpose() + nalgebra::Matrix3::identity() * 0.02;
        let [xx, xy, xz, yy, yz, zz] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|at| inertia[at]);
        let mass = 1.5 + random.number();
        text += &format!(
            "<link name=\"body_{next}\"><inertial><origin xyz=\"{com}\"/><mass value=\"{mass}\"/>\
             <inertia ixx=\"{xx}\" ixy=\"{xy}\" ixz=\"{xz}\" iyy=\"{yy}\" iyz=\"{yz}\" izz=\"{zz}\"/></inertial></link>\
             <joint name=\"joint_{next}\" type=\"{kind}\"><parent link=\"body_{i}\"/><child link=\"body_{next}\"/>\
             <origin xyz=\"{xyz}\" rpy=\"{rpy}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-3\" upper=\"2\" velocity=\"5\" effort=\"{effort}\"/></joint>",
            next = i + 1
        );
    }
    let model = Model::from_urdf(&(text + "</robot>")).unwrap_or_else(|e| panic!("{e}"));
    let rotors = ActuatedVector::from_fn(model.sizes(), |_| 0.1 + 0.1 * random.number());
    model.with_rotors(&rotors)
}
