//! The robot and random states for the tests of the model.

use upswing_model::{ActuatedVector, JointVector, Model, NQ, State};

pub fn robot() -> Model {
    Model::from_urdf(include_str!("../../../config/robot.urdf")).expect("the shipped robot loads")
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
        JointVector::from_fn(|i, _| self.q[i])
    }

    pub fn qd(&self) -> JointVector {
        JointVector::from_fn(|i, _| self.qd[i])
    }

    pub fn x(&self) -> State {
        State::from_fn(|i, _| if i < NQ { self.q[i] } else { self.qd[i - NQ] })
    }

    pub fn u(&self) -> ActuatedVector {
        ActuatedVector::from_fn(|i, _| self.u[i])
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
