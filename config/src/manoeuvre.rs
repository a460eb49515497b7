//! Manoeuvres of a system, `manoeuvres.toml`: where they start, and the rows of their target (8).

mod check;

use crate::conflict::{SettingsConflict, in_file, unit};
use crate::file::TextFile;
use crate::rule::{Finite, Positive, Rule, Whole};
use crate::{Config, ConfigError, GridAxis, GridSettings, RobotSettings};
use check::Mistake;
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;
use std::fmt::Display;
use toml::Spanned;
use upswing_model::{
    JointKind, JointVector, LimitKind, Limits, Model, Posture, RestError, State, UnactuatedVector, Workspace,
};

/// Largest number of start poses, so that a typing error does not exhaust the memory.
const MOST_POSES: usize = 1_000_000;
/// Longest name of a manoeuvre, bytes: those of a request.
const LONGEST_NAME: usize = 32;

/// A motion from rest to rest: planned when an operator requests it.
#[derive(Clone, Debug, PartialEq)]
pub struct Manoeuvre {
    /// Name in requests and of the database.
    pub name: String,
    /// Posture in which it starts.
    pub start: Posture,
    /// Posture in which it ends.
    pub end: Posture,
    /// Rows of the end state x_N, (8), at rest; none if it `reverses` another manoeuvre: it ends where the entry of the database began.
    pub target: Vec<TargetRow>,
    /// Start poses of the database; those of the other manoeuvre if it `reverses` one.
    pub grid: GridSettings,
    /// Index in [`crate::Config::manoeuvres`] of the manoeuvre that this one is run backwards.
    pub reverses: Option<usize>,
}

/// One row of a target: `coefficients` . q_N = `value`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetRow {
    /// Of q_N; 1 for the joint of a row of one joint.
    pub coefficients: JointVector,
    /// What the product shall be.
    pub value: TargetValue,
}

/// Value of a row of a target, rad or m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TargetValue {
    /// A number.
    Fixed(f64),
    /// The request gives the position of an actuated joint; the axis has those of the database.
    Given(GridAxis),
    /// The position at which an unactuated joint hangs.
    Rest,
}

/// Why values that a request gives are no target.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GivenError {
    /// The wrong number of values.
    #[error("expected {}, got {got}", match .expected { 0 => "no value".into(), 1 => "1 value".into(), n => format!("{n} values") })]
    Number {
        /// Number of rows whose value the request gives.
        expected: usize,
        /// Number of values.
        got: usize,
    },
    /// The unactuated joints have no rest position in the pose.
    #[error(transparent)]
    NoRest(#[from] RestError),
}

/// A position that a request gives is outside the limits of its joint.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("target of joint `{joint}`: expected {min:.3} to {max:.3} {unit}, got {got:.3} {unit}")]
pub struct GivenOutsideLimits {
    /// Name of the joint.
    pub joint: String,
    /// Lower end of the range open to plans, in `unit`.
    pub min: f64,
    /// Its upper end, in `unit`.
    pub max: f64,
    /// The position, in `unit`.
    pub got: f64,
    /// `deg` or `m`.
    pub unit: &'static str,
}

impl GivenOutsideLimits {
    /// Checks the position `q` (rad or m) that a request gives to `joint` against the limits of plans.
    ///
    /// # Errors
    /// [`GivenOutsideLimits`], also for NaN.
    pub fn check(config: &Config, joint: usize, q: f64) -> Result<(), Self> {
        let (min, max) = config.robot.planning.range(LimitKind::Position, joint);
        if q >= min && q <= max {
            return Ok(());
        }
        let kind = config.model.joint_kind(joint);
        let [(min, unit), (max, _), (got, _)] = [min, max, q].map(|q| kind.shown(q));
        Err(Self { joint: config.model.joint_name(joint).to_owned(), min, max, got, unit })
    }
}

impl Manoeuvre {
    /// The joints whose positions a request gives, in the order of their rows, and their positions in the database.
    pub fn given(&self) -> impl Iterator<Item = &GridAxis> {
        self.target.iter().filter_map(|row| match &row.value {
            TargetValue::Given(axis) => Some(axis),
            _ => None,
        })
    }

    /// The rows of the target with the values that a request gives, rad or m, in the order of [`Manoeuvre::given`]: coefficients of q_N,
    /// and value.
    ///
    /// # Errors
    /// [`GivenError`] if the number of values is another one, or if there is no rest position.
    pub fn rows(&self, model: &Model, given: &[f64]) -> Result<Vec<(JointVector, f64)>, GivenError> {
        let expected = self.given().count();
        if given.len() != expected {
            return Err(GivenError::Number { expected, got: given.len() });
        }
        let mut given = given.iter();
        let mut value = |row: &TargetRow| match row.value {
            TargetValue::Fixed(value) => Some(value),
            TargetValue::Given(_) => given.next().copied(),
            TargetValue::Rest => None,
        };
        let rows: Vec<_> = self.target.iter().map(|row| (row.coefficients, value(row))).collect();
        let known: Vec<_> = rows.iter().filter_map(|(row, value)| value.map(|value| (*row, value))).collect();
        if known.len() == rows.len() {
            return Ok(known);
        }
        let pose = nearest(&known, &JointVector::zeros(model.sizes()));
        let rest = model.rest_position(&pose, &mut Workspace::default())?;
        Ok(rows.into_iter().map(|(row, value)| (row, value.unwrap_or_else(|| row.dot(&rest)))).collect())
    }
}

/// Tolerance of the largest rest angle, rad or m: poses of a grid hang at exactly this angle, but for the rounding of their rest position.
const ROUNDING: f64 = 1e-9;

impl Manoeuvre {
    /// The state at rest in the posture of the start with the actuated joints at `q_a` (rad or m); `None` if the rules of the grid leave
    /// this pose out: the unactuated joints are not in equilibrium, or not within `limits` or the largest rest angle. In a manoeuvre that
    /// starts standing they are where the target has them.
    pub fn start_state(&self, model: &Model, limits: &Limits, q_a: &[f64]) -> Option<State> {
        let start = match self.start {
            Posture::Hanging => {
                let start = model.standstill(limits, q_a, None).ok();
                start.filter(|x| x.q_u().amax() <= self.grid.max_rest_angle + ROUNDING)?
            }
            Posture::Standing => self.state_as_in_target(model, limits, q_a)?,
        };
        (model.posture(&start.q(), &mut Workspace::default()) == self.start).then_some(start)
    }

    /// The state at rest with the actuated joints at `q_a` (rad or m) and the unactuated ones where rows of the target have them; `None` if
    /// they are not in equilibrium there, or not within `limits`.
    pub fn state_as_in_target(&self, model: &Model, limits: &Limits, q_a: &[f64]) -> Option<State> {
        let sizes = model.sizes();
        let q_u = UnactuatedVector::from_fn(sizes, |i| self.fixed(sizes.actuated() + i).unwrap_or_default());
        let state = model.standstill(limits, q_a, Some(&q_u)).ok()?;
        model.check_equilibrium(&state, &mut Workspace::default()).is_ok().then_some(state)
    }

    /// The position of a joint (index in q) in the target, if a row of this joint alone states it.
    fn fixed(&self, joint: usize) -> Option<f64> {
        self.target.iter().find_map(|row| match row.value {
            TargetValue::Fixed(value)
                if row.coefficients.iter().enumerate().all(|(i, c)| (i == joint) == (*c != 0.0)) =>
            {
                Some(value / row.coefficients[joint])
            }
            _ => None,
        })
    }
}

/// The q closest to `q` that meets `rows`, which do not depend on each other: one row after the other, made orthogonal to those before it.
fn nearest(rows: &[(JointVector, f64)], q: &JointVector) -> JointVector {
    let (mut q, mut basis) = (*q, Vec::<(JointVector, f64)>::new());
    for (row, value) in rows {
        let (mut row, mut value) = (*row, *value);
        for (known, its_value) in &basis {
            let share = row.dot(known);
            (row, value) = (row - *known * share, value - its_value * share);
        }
        let norm = row.norm();
        let (row, value) = (row / norm, value / norm);
        q += row * (value - row.dot(&q));
        basis.push((row, value));
    }
    q
}

/// Contents of `manoeuvres.toml`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ManoeuvresInFile {
    manoeuvre: Vec<Spanned<ManoeuvreInFile>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ManoeuvreInFile {
    name: String,
    reverses: Option<String>,
    start: Option<PostureInFile>,
    end: Option<PostureInFile>,
    target: Option<Spanned<Vec<Spanned<RowInFile>>>>,
    grid: Option<Spanned<Vec<Spanned<RowInFile>>>>,
    #[serde(default, deserialize_with = "Positive::degrees")]
    max_rest_angle_deg: Option<f64>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum PostureInFile {
    Hanging,
    Standing,
}

impl From<PostureInFile> for Posture {
    fn from(posture: PostureInFile) -> Self {
        match posture {
            PostureInFile::Hanging => Self::Hanging,
            PostureInFile::Standing => Self::Standing,
        }
    }
}

/// A row of a target, or an axis of a grid, as a file states it; numbers with the keys of one of both units.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RowInFile {
    joint: Option<String>,
    coefficients: Option<BTreeMap<String, f64>>,
    #[serde(default)]
    given: bool,
    #[serde(default)]
    rest: bool,
    #[serde(default, deserialize_with = "Finite::degrees")]
    value_deg: Option<f64>,
    #[serde(default, deserialize_with = "Finite::read")]
    value_m: Option<f64>,
    #[serde(default, deserialize_with = "Finite::degrees")]
    from_deg: Option<f64>,
    #[serde(default, deserialize_with = "Finite::degrees")]
    to_deg: Option<f64>,
    #[serde(default, deserialize_with = "Finite::read")]
    from_m: Option<f64>,
    #[serde(default, deserialize_with = "Finite::read")]
    to_m: Option<f64>,
    #[serde(default, deserialize_with = "points")]
    points: Option<usize>,
}

fn points<'de, D: Deserializer<'de>>(from: D) -> Result<Option<usize>, D::Error> {
    Whole::<2, { MOST_POSES as i64 }>::read(from).map(Some)
}

impl RowInFile {
    /// The number of the key that ends in the unit of a joint of this kind; the other one of both keys has to be absent.
    fn number(
        &self,
        key: &str,
        kind: JointKind,
        deg: Option<f64>,
        m: Option<f64>,
    ) -> Result<Option<f64>, String> {
        let (own, other, other_unit) = if unit(kind) == "m" { (m, deg, "deg") } else { (deg, m, "m") };
        match other {
            Some(_) => {
                let of = self.joint.as_ref().map_or("these joints".into(), |name| format!("joint `{name}`"));
                Err(format!(".{key}_{other_unit}: expected {key}_{} for {of}", unit(kind)))
            }
            None => Ok(own),
        }
    }

    /// The one value of a joint of this kind.
    fn value(&self, kind: JointKind) -> Result<Option<f64>, String> {
        self.number("value", kind, self.value_deg, self.value_m)
    }

    /// The positions of the actuated joint of the row, within `limits`, or what is wrong: a `reason` for [`TextFile::error`].
    fn axis(&self, model: &Model, limits: &Limits) -> Result<GridAxis, String> {
        let joint = self.joint(model, 0..model.sizes().actuated())?;
        let kind = model.joint_kind(joint);
        let from = self.number("from", kind, self.from_deg, self.from_m)?;
        let to = self.number("to", kind, self.to_deg, self.to_m)?;
        let unit = unit(kind);
        let (from, to, points) = match (self.value(kind)?, from, to, self.points) {
            (Some(value), None, None, None) => (("value", value), ("value", value), 1),
            (None, Some(from), Some(to), Some(points)) => (("from", from), ("to", to), points),
            _ => {
                let name = model.joint_name(joint);
                return Err(format!(
                    "expected value_{unit}, or from_{unit}, to_{unit} and points, for joint `{name}`, got other keys"
                ));
            }
        };
        for (key, position) in [from, to] {
            SettingsConflict::unless_within(&format!(".{key}"), position, joint, limits, model)
                .map_err(|conflict| conflict.to_string())?;
        }
        let [low, high] = [from.1, to.1].map(|q| in_file(kind, q));
        if points > 1 {
            SettingsConflict::unless_above(format!(".to_{unit}"), high, low, &format!("from_{unit}"))
                .map_err(|conflict| conflict.to_string())?;
        }
        Ok(GridAxis { joint, from: from.1, to: to.1, points })
    }

    /// Index in q of the joint of the row, one of those with the indices `among`.
    fn joint(&self, model: &Model, among: std::ops::Range<usize>) -> Result<usize, String> {
        let names = || among.clone().map(|joint| model.joint_name(joint)).collect::<Vec<_>>().join(", ");
        let Some(name) = &self.joint else {
            return Err(format!("expected `joint`, one of {}, got none", names()));
        };
        among
            .clone()
            .find(|joint| model.joint_name(*joint) == name)
            .ok_or_else(|| format!(".joint: expected one of {}, got `{name}`", names()))
    }

    /// The row of a target, or what is wrong: a `reason` for [`TextFile::error`].
    fn target(&self, model: &Model, limits: &Limits) -> Result<TargetRow, String> {
        let sizes = model.sizes();
        let unit_row = |joint: usize| JointVector::from_fn(sizes, |i| f64::from(u8::from(i == joint)));
        let numbers = [self.value_deg, self.value_m, self.from_deg, self.to_deg, self.from_m, self.to_m];
        match (&self.coefficients, self.given, self.rest) {
            (None, true, false) => {
                let axis = self.axis(model, limits)?;
                Ok(TargetRow { coefficients: unit_row(axis.joint), value: TargetValue::Given(axis) })
            }
            (None, false, true) => {
                let joint = self.joint(model, sizes.actuated()..sizes.joints())?;
                if numbers.iter().any(Option::is_some) || self.points.is_some() {
                    return Err("expected no value with `rest = true`, got one: remove one of both".into());
                }
                Ok(TargetRow { coefficients: unit_row(joint), value: TargetValue::Rest })
            }
            (coefficients, false, false) => {
                let (coefficients, kind) = match coefficients {
                    None => {
                        let joint = self.joint(model, 0..sizes.joints())?;
                        (unit_row(joint), model.joint_kind(joint))
                    }
                    Some(_) if self.joint.is_some() => {
                        return Err("expected `joint` or `coefficients`, got both: remove one of both".into());
                    }
                    Some(by_name) => sum_of_joints(by_name, model)?,
                };
                let range = numbers[2..].iter().any(Option::is_some) || self.points.is_some();
                match self.value(kind)? {
                    Some(value) if !range => Ok(TargetRow { coefficients, value: TargetValue::Fixed(value) }),
                    _ => Err(format!("expected value_{}, `given = true` or `rest = true`", unit(kind))),
                }
            }
            _ => {
                Err("expected one of `coefficients`, `given = true` and `rest = true`, got two of them"
                    .into())
            }
        }
    }
}

/// The coefficients of q of a sum over joints, and the kind of these joints.
fn sum_of_joints(by_name: &BTreeMap<String, f64>, model: &Model) -> Result<(JointVector, JointKind), String> {
    let mut coefficients = JointVector::zeros(model.sizes());
    let mut first = None;
    for (name, coefficient) in by_name {
        let Some(joint) = model.coordinate(name) else {
            let names = model.joint_names().collect::<Vec<_>>().join(", ");
            return Err(format!(".coefficients: expected names of joints, {names}, got `{name}`"));
        };
        if !coefficient.is_finite() || *coefficient == 0.0 {
            let expected = format!(".coefficients: expected a finite number other than 0 for joint `{name}`");
            return Err(format!("{expected}, got {coefficient}"));
        }
        let kind = model.joint_kind(joint);
        match first {
            Some(first) if unit(first) != unit(kind) => {
                return Err(".coefficients: expected joints of one unit, deg or m, got both".into());
            }
            _ => first = Some(kind),
        }
        coefficients[joint] = *coefficient;
    }
    let kind = first.ok_or(".coefficients: expected at least one joint, got none")?;
    Ok((coefficients, kind))
}

/// A file with manoeuvres or a grid, and the robot for which it is.
struct Reader<'a> {
    file: &'a TextFile,
    robot: &'a RobotSettings,
    model: &'a Model,
}

impl Reader<'_> {
    fn refuse(&self, at: usize, key: &str, reason: impl Display) -> ConfigError {
        self.file.error(at, Some(key.into()), reason)
    }

    /// The grid of the `axes` of a `key` at byte offset `at`.
    fn grid(
        &self,
        key: &str,
        at: usize,
        axes: &[Spanned<RowInFile>],
        max_rest_angle: Option<f64>,
    ) -> Result<GridSettings, ConfigError> {
        let mut grid = GridSettings {
            sizes: self.model.sizes(),
            axes: Vec::new(),
            max_rest_angle: max_rest_angle.unwrap_or(f64::INFINITY),
        };
        for row in axes {
            let refuse = |reason: String| self.refuse(row.span().start, key, reason);
            let axis = row.get_ref().axis(self.model, &self.robot.planning).map_err(refuse)?;
            if grid.axes.iter().any(|known| known.joint == axis.joint) {
                let name = self.model.joint_name(axis.joint);
                return Err(refuse(format!(
                    "expected each joint at most once, got joint `{name}` twice: remove one row"
                )));
            }
            grid.axes.push(axis);
        }
        let poses = grid.axes.iter().fold(1, |poses: usize, axis| poses.saturating_mul(axis.points));
        if grid.axes.is_empty() || poses > MOST_POSES {
            let expected = format!("expected at least one joint and at most {MOST_POSES} start poses");
            let got = format!("got {} joints, {poses} start poses", grid.axes.len());
            return Err(self.refuse(
                at,
                key,
                format!("{expected}, {got}: change the list or its numbers of points"),
            ));
        }
        Ok(grid)
    }
}

/// Reads the grid of start poses in `file`.
pub(crate) fn read_grid(
    file: &TextFile,
    robot: &RobotSettings,
    model: &Model,
) -> Result<GridSettings, ConfigError> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct GridInFile {
        grid: Spanned<Vec<Spanned<RowInFile>>>,
        #[serde(default, deserialize_with = "Positive::degrees")]
        max_rest_angle_deg: Option<f64>,
    }
    let GridInFile { grid, max_rest_angle_deg } = file.parse(model)?;
    Reader { file, robot, model }.grid("grid", grid.span().start, grid.get_ref(), max_rest_angle_deg)
}

/// Reads the manoeuvres in `file`.
pub(crate) fn read(
    file: &TextFile,
    robot: &RobotSettings,
    model: &Model,
) -> Result<Vec<Manoeuvre>, ConfigError> {
    let reader = Reader { file, robot, model };
    let ManoeuvresInFile { manoeuvre } = file.parse(model)?;
    let mut manoeuvres = Vec::<Manoeuvre>::new();
    let mut reversed = Vec::new();
    for manoeuvre in manoeuvre {
        let at = manoeuvre.span().start;
        let ManoeuvreInFile { name, reverses, start, end, target, grid, max_rest_angle_deg } =
            manoeuvre.into_inner();
        if let Some(reason) = bad_name(&name, &manoeuvres) {
            return Err(reader.refuse(at, "manoeuvre.name", reason));
        }
        if let Some(original) = reverses {
            if start.is_some()
                || end.is_some()
                || target.is_some()
                || grid.is_some()
                || max_rest_angle_deg.is_some()
            {
                let reason = format!(
                    "expected no other keys than `name` and `reverses` for manoeuvre `{name}`, got others: remove them, or \
                     `reverses`; a reversal has start, end and grid of `{original}`"
                );
                return Err(reader.refuse(at, "manoeuvre", reason));
            }
            reversed.push((manoeuvres.len(), at, original));
            // Completed below, when all names are known.
            let (start, end) = (Posture::Standing, Posture::Hanging);
            let grid = GridSettings { sizes: model.sizes(), axes: Vec::new(), max_rest_angle: f64::INFINITY };
            manoeuvres.push(Manoeuvre { name, start, end, target: Vec::new(), grid, reverses: None });
            continue;
        }
        let missing = |key: &str| {
            reader.refuse(
                at,
                "manoeuvre",
                format!("missing `{key}` of manoeuvre `{name}`, which has no `reverses`"),
            )
        };
        let (start, end) = (start.ok_or_else(|| missing("start"))?, end.ok_or_else(|| missing("end"))?);
        let (target, grid) = (target.ok_or_else(|| missing("target"))?, grid.ok_or_else(|| missing("grid"))?);
        let (target_at, grid_at) = (target.span().start, grid.span().start);
        let (target, grid) = (target.into_inner(), grid.into_inner());
        let rows_at: Vec<_> = target.iter().map(|row| row.span().start).collect();
        let rows = target.iter().map(|row| {
            let row_at = row.span().start;
            let row = row.get_ref().target(model, &robot.planning);
            row.map_err(|reason| reader.refuse(row_at, "manoeuvre.target", reason))
        });
        let target = rows.collect::<Result<Vec<_>, _>>()?;
        let grid = reader.grid("manoeuvre.grid", grid_at, &grid, max_rest_angle_deg)?;
        let (start, end) = (start.into(), end.into());
        let manoeuvre = Manoeuvre { name, start, end, target, grid, reverses: None };
        check::check(&manoeuvre, model, &robot.planning).map_err(|mistake| match mistake {
            Mistake::Row(row, _) => reader.refuse(rows_at[row], "manoeuvre.target", mistake),
            Mistake::Target(_) => reader.refuse(target_at, "manoeuvre.target", mistake),
            Mistake::Grid(_) => reader.refuse(grid_at, "manoeuvre.grid", mistake),
        })?;
        manoeuvres.push(manoeuvre);
    }
    if manoeuvres.is_empty() {
        return Err(reader.refuse(0, "manoeuvre", "expected at least one manoeuvre, got none"));
    }
    for (number, at, name) in &reversed {
        let of_target = |index: &usize| !reversed.iter().any(|(number, ..)| number == index);
        let original = (0..manoeuvres.len()).filter(of_target).find(|i| manoeuvres[*i].name == *name);
        let Some(original) = original else {
            let names = (0..manoeuvres.len()).filter(of_target).map(|i| manoeuvres[i].name.as_str());
            let names = names.collect::<Vec<_>>().join(", ");
            let reason =
                format!("expected the name of a manoeuvre with a target, one of {names}, got `{name}`");
            return Err(reader.refuse(*at, "manoeuvre.reverses", reason));
        };
        let Manoeuvre { start, end, grid, .. } = manoeuvres[original].clone();
        let reverse = &mut manoeuvres[*number];
        (reverse.start, reverse.end, reverse.grid, reverse.reverses) = (end, start, grid, Some(original));
    }
    Ok(manoeuvres)
}

/// Why a manoeuvre cannot have the name `name` besides the `known` ones.
fn bad_name(name: &str, known: &[Manoeuvre]) -> Option<String> {
    /// Requests of all systems, from which a manoeuvre has to differ on the command line.
    const REQUESTS: [&str; 4] = ["hold", "stop", "enable", "reset"];
    let is_plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
    if name.is_empty() || name.len() > LONGEST_NAME || !name.bytes().all(is_plain) || REQUESTS.contains(&name)
    {
        return Some(format!(
            "expected 1 to {LONGEST_NAME} of the characters a-z, 0-9 and -, and none of the requests {}, got `{name}`",
            REQUESTS.join(", ")
        ));
    }
    let twice = known.iter().any(|manoeuvre| manoeuvre.name == name);
    twice.then(|| format!("expected another name for each manoeuvre, got `{name}` twice"))
}
