//! Settings with one value per joint: `100` for all joints, or a table by joint name, `{ default = 100, joint_3 = 50 }`.
//!
//! The fields of settings are read by serde, which gives them no context. A deserializer made by [`JointList::around`] carries the
//! joints of the robot to all fields, and the type [`OfRobot`] receives them there.

use crate::rule::{Quantity, Rule, refused};
use serde::Deserialize;
use serde::de::{
    DeserializeSeed, Deserializer, Error, IntoDeserializer, MapAccess, SeqAccess, Unexpected, Visitor,
};
use std::fmt;
use std::marker::PhantomData;
use upswing_model::{Actuated, JointKind, Joints, MOST_JOINTS, Model, Sizes, Space, Unactuated, Vector};

/// Name of the value of all joints that a table does not name.
pub(crate) const DEFAULT: &str = "default";

/// The joints of a robot, in the order of the model's vectors.
#[derive(Clone, Debug)]
pub(crate) struct JointList {
    sizes: Sizes,
    names: Vec<String>,
    prismatic: Vec<bool>,
}

impl JointList {
    /// The joints of `model`.
    pub fn of(model: &Model) -> Self {
        let all = 0..model.sizes().joints();
        Self {
            sizes: model.sizes(),
            names: all.clone().map(|joint| model.joint_name(joint).to_owned()).collect(),
            prismatic: all.map(|joint| model.joint_kind(joint) == JointKind::Prismatic).collect(),
        }
    }

    /// The deserializer `inner` with these joints.
    pub fn around<D>(&self, inner: D) -> InRobot<'_, D> {
        InRobot { inner, joints: self }
    }

    /// The value of each of the joints with the indices `among`, which may be none, or what is wrong: a `reason` for
    /// [`crate::file::TextFile::error`].
    fn values<T: Copy>(&self, among: &[usize], per_joint: &PerJoint<T>) -> Result<Vec<T>, String> {
        let by_name = match per_joint {
            PerJoint::Same(value) => return Ok(vec![*value; among.len()]),
            PerJoint::ByName(by_name) => by_name,
        };
        let names: Vec<_> = among.iter().map(|joint| self.names[*joint].as_str()).collect();
        if let Some((name, _)) =
            by_name.iter().find(|(name, _)| name != DEFAULT && !names.contains(&name.as_str()))
        {
            let names = names.join(", ");
            let of_names =
                if names.is_empty() { "no joint of this kind".into() } else { format!("one of {names}") };
            let urdf = crate::URDF;
            return Err(format!(
                ".{name}: expected `{DEFAULT}` or {of_names}, got `{name}` (joints of {urdf})"
            ));
        }
        let of = |wanted: &str| by_name.iter().find(|(name, _)| name == wanted).map(|(_, value)| *value);
        let urdf = crate::URDF;
        let missing = |name| {
            format!("expected a value for joint `{name}` or a `{DEFAULT}`, got neither (joint of {urdf})")
        };
        names.iter().map(|name| of(name).or_else(|| of(DEFAULT)).ok_or_else(|| missing(name))).collect()
    }
}

/// A part of a deserializer, with the joints of the robot.
pub(crate) struct InRobot<'a, T> {
    inner: T,
    joints: &'a JointList,
}

/// A value of a file, after names, number of the actuated ones and "is prismatic" of the joints of the robot.
#[derive(Deserialize)]
struct OfRobot<T>(Vec<String>, usize, Vec<bool>, T);

/// The name under which serde asks a deserializer for an [`OfRobot`].
const OF_ROBOT: &str = "OfRobot";

impl<T> OfRobot<T> {
    /// The joints and the value.
    fn parts<E: Error>(self) -> Result<(JointList, T), E> {
        let Self(names, actuated, prismatic, value) = self;
        let sizes = Sizes::new(names.len(), actuated).ok_or_else(|| E::custom("no joints"))?;
        Ok((JointList { sizes, names, prismatic }, value))
    }
}

macro_rules! forward {
    ($($method:ident($($name:ident: $type:ty),*);)*) => {$(
        fn $method<V: Visitor<'de>>(self, $($name: $type,)* visitor: V) -> Result<V::Value, D::Error> {
            self.inner.$method($($name,)* visitor)
        }
    )*};
}

impl<'de, D: Deserializer<'de>> Deserializer<'de> for InRobot<'_, D> {
    type Error = D::Error;

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        if name == OF_ROBOT {
            return visitor.visit_seq(OfRobotAccess {
                joints: self.joints,
                value: Some(self.inner),
                given: 0,
            });
        }
        self.inner.deserialize_tuple_struct(name, len, visitor)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        self.inner.deserialize_struct(name, fields, self.joints.around(visitor))
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, D::Error> {
        self.inner.deserialize_seq(self.joints.around(visitor))
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, D::Error> {
        self.inner.deserialize_option(self.joints.around(visitor))
    }

    forward! {
        deserialize_any(); deserialize_bool();
        deserialize_i8(); deserialize_i16(); deserialize_i32(); deserialize_i64();
        deserialize_u8(); deserialize_u16(); deserialize_u32(); deserialize_u64();
        deserialize_f32(); deserialize_f64();
        deserialize_char(); deserialize_str(); deserialize_string();
        deserialize_bytes(); deserialize_byte_buf();
        deserialize_unit(); deserialize_map();
        deserialize_identifier(); deserialize_ignored_any();
        deserialize_unit_struct(name: &'static str); deserialize_newtype_struct(name: &'static str);
        deserialize_tuple(len: usize);
        deserialize_enum(name: &'static str, variants: &'static [&'static str]);
    }
}

impl<'de, V: Visitor<'de>> Visitor<'de> for InRobot<'_, V> {
    type Value = V::Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.expecting(f)
    }

    fn visit_none<E: Error>(self) -> Result<V::Value, E> {
        self.inner.visit_none()
    }

    fn visit_some<D: Deserializer<'de>>(self, from: D) -> Result<V::Value, D::Error> {
        self.inner.visit_some(self.joints.around(from))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<V::Value, A::Error> {
        self.inner.visit_map(self.joints.around(map))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<V::Value, A::Error> {
        self.inner.visit_seq(self.joints.around(seq))
    }
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for InRobot<'_, A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, A::Error> {
        self.inner.next_key_seed(seed)
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, A::Error> {
        self.inner.next_value_seed(self.joints.around(seed))
    }
}

impl<'de, A: SeqAccess<'de>> SeqAccess<'de> for InRobot<'_, A> {
    type Error = A::Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, A::Error> {
        self.inner.next_element_seed(self.joints.around(seed))
    }
}

impl<'de, S: DeserializeSeed<'de>> DeserializeSeed<'de> for InRobot<'_, S> {
    type Value = S::Value;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<S::Value, D::Error> {
        self.inner.deserialize(self.joints.around(from))
    }
}

/// The four parts of an [`OfRobot`].
struct OfRobotAccess<'a, D> {
    joints: &'a JointList,
    value: Option<D>,
    given: usize,
}

impl<'de, D: Deserializer<'de>> SeqAccess<'de> for OfRobotAccess<'_, D> {
    type Error = D::Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, D::Error> {
        self.given += 1;
        match self.given {
            1 => seed.deserialize(self.joints.names.clone().into_deserializer()).map(Some),
            2 => seed.deserialize(self.joints.sizes.actuated().into_deserializer()).map(Some),
            3 => seed.deserialize(self.joints.prismatic.clone().into_deserializer()).map(Some),
            _ => self.value.take().map(|value| seed.deserialize(value)).transpose(),
        }
    }
}

/// A value per joint as a file states it.
enum PerJoint<T> {
    /// One value for all joints.
    Same(T),
    /// Values by joint name, or [`DEFAULT`].
    ByName(Vec<(String, T)>),
}

/// The value of one joint: a number, or a range.
pub(crate) trait JointValue: Copy {
    /// A setting of such values, in messages after "expected".
    const FORM: &'static str;

    /// The value of `number`; `None` if the value of a joint is a list.
    fn of_number(number: f64) -> Option<Self>;

    /// The value of `list`; `None` if it has another length, or if the value of a joint is a number.
    fn of_list(list: &[f64]) -> Option<Self>;

    /// Reads the value of one joint.
    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error>;

    /// The text "expected .., got .." if the value violates the rule `R`.
    fn violation<R: Rule>(&self) -> Option<String>;

    /// The value in SI units.
    fn times(self, unit: f64) -> Self;
}

impl JointValue for f64 {
    const FORM: &'static str =
        "a number for all joints, or a table of numbers by joint name, as in { default = 1, joint_1 = 2 }";

    fn of_number(number: f64) -> Option<Self> {
        Some(number)
    }

    fn of_list(_: &[f64]) -> Option<Self> {
        None
    }

    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Self::deserialize(from)
    }

    fn violation<R: Rule>(&self) -> Option<String> {
        (!R::holds(*self)).then(|| format!("expected {}, got {self}", R::EXPECTED))
    }

    fn times(self, unit: f64) -> Self {
        self * unit
    }
}

/// A range, [lowest, highest].
pub(crate) type Range = [f64; 2];

impl JointValue for Range {
    const FORM: &'static str = "a range [lowest, highest] for all joints, or a table of ranges by joint name, as in \
                                { default = [-1, 1], joint_1 = [-2, 3] }";

    fn of_number(_: f64) -> Option<Self> {
        None
    }

    fn of_list(list: &[f64]) -> Option<Self> {
        list.try_into().ok()
    }

    fn read<'de, D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let list = Vec::deserialize(from)?;
        Self::of_list(&list).ok_or_else(|| refused("[lowest, highest]", format!("a list of {}", list.len())))
    }

    fn violation<R: Rule>(&self) -> Option<String> {
        let [low, high] = self;
        let number = self.iter().find_map(f64::violation::<R>);
        number.or_else(|| (low >= high).then(|| format!("expected [lowest, highest], got [{low}, {high}]")))
    }

    fn times(self, unit: f64) -> Self {
        self.map(|v| v * unit)
    }
}

/// The value of one joint.
struct OneValue<T>(T);

impl<'de, T: JointValue> Deserialize<'de> for OneValue<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        T::read(from).map(Self)
    }
}

impl<'de, T: JointValue> Deserialize<'de> for PerJoint<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct PerJointVisitor<T>(PhantomData<T>);

        impl<'de, T: JointValue> Visitor<'de> for PerJointVisitor<T> {
            type Value = PerJoint<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(T::FORM)
            }

            fn visit_i64<E: Error>(self, number: i64) -> Result<Self::Value, E> {
                self.visit_f64(number as f64)
            }

            fn visit_f64<E: Error>(self, number: f64) -> Result<Self::Value, E> {
                let value = T::of_number(number);
                value.map(PerJoint::Same).ok_or_else(|| E::invalid_type(Unexpected::Float(number), &self))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
                let mut list = Vec::new();
                while let Some(number) = seq.next_element()? {
                    list.push(number);
                }
                let value = T::of_list(&list);
                let got = || refused(T::FORM, format!("a list of {}", list.len()));
                value.map(PerJoint::Same).ok_or_else(got)
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut by_name = Vec::new();
                while let Some((name, OneValue(value))) = map.next_entry()? {
                    by_name.push((name, value));
                }
                Ok(PerJoint::ByName(by_name))
            }
        }

        from.deserialize_any(PerJointVisitor(PhantomData))
    }
}

impl<T: JointValue> PerJoint<T> {
    /// Reads values, checks each against the rule `R` and multiplies it by `unit`; returns them with the joints of the robot.
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<(JointList, Self), D::Error> {
        let (joints, mut per_joint) = OfRobot::<Self>::deserialize(from)?.parts()?;
        let checked = |value: &mut T, prefix: &str| match value.violation::<R>() {
            Some(violation) => Err(D::Error::custom(format_args!("{prefix}{violation}"))),
            None => {
                *value = value.times(unit);
                Ok(())
            }
        };
        match &mut per_joint {
            Self::Same(value) => checked(value, "")?,
            Self::ByName(by_name) => {
                by_name.iter_mut().try_for_each(|(name, value)| checked(value, &format!(".{name}: ")))?;
            }
        }
        Ok((joints, per_joint))
    }
}

/// The joints of a vector.
pub(crate) trait JointSpace: Space {
    /// Index of the first of them among all joints.
    fn first(sizes: Sizes) -> usize;

    /// Their indices among all joints.
    fn joints(sizes: Sizes) -> std::ops::Range<usize> {
        Self::first(sizes)..Self::first(sizes) + Self::length(sizes)
    }
}

impl JointSpace for Joints {
    fn first(_: Sizes) -> usize {
        0
    }
}

impl JointSpace for Actuated {
    fn first(_: Sizes) -> usize {
        0
    }
}

impl JointSpace for Unactuated {
    fn first(sizes: Sizes) -> usize {
        sizes.actuated()
    }
}

impl<S: JointSpace> Quantity for Vector<S, MOST_JOINTS> {
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<Self, D::Error> {
        let (joints, per_joint) = PerJoint::read::<R, D>(from, unit)?;
        let among: Vec<_> = S::joints(joints.sizes).collect();
        let values = joints.values(&among, &per_joint).map_err(D::Error::custom)?;
        Ok(Self::from_fn(joints.sizes, |i| values[i]))
    }
}

/// Values of those joints of the space `S` that are prismatic (key in m), or those that are not (key in deg).
pub(crate) struct OfKind<S, T, const PRISMATIC: bool> {
    joints: JointList,
    /// Values of the joints of `S`; `None` for those of the other kind.
    values: Vec<Option<T>>,
    space: PhantomData<S>,
}

/// Values of the joints that turn.
pub(crate) type Revolute<S, T = f64> = OfKind<S, T, false>;
/// Values of the joints that slide.
pub(crate) type Prismatic<S, T = f64> = OfKind<S, T, true>;

impl<S: JointSpace, T: JointValue, const PRISMATIC: bool> Quantity for OfKind<S, T, PRISMATIC> {
    fn read<'de, R: Rule, D: Deserializer<'de>>(from: D, unit: f64) -> Result<Self, D::Error> {
        let (joints, per_joint) = PerJoint::read::<R, D>(from, unit)?;
        let is_of_kind = |joint: &usize| joints.prismatic[*joint] == PRISMATIC;
        let among: Vec<_> = S::joints(joints.sizes).filter(is_of_kind).collect();
        let mut of_kind = joints.values(&among, &per_joint).map_err(D::Error::custom)?.into_iter();
        let values =
            S::joints(joints.sizes).map(|joint| is_of_kind(&joint).then(|| of_kind.next()).flatten());
        let values = values.collect();
        Ok(Self { joints, values, space: PhantomData })
    }
}

/// The numbers of joints, and the values of the joints of the space `S` from two keys, `deg_key` for revolute and `m_key` for prismatic
/// joints, or what is missing: a `reason` for [`crate::file::TextFile::error`]. A key without joints is absent.
pub(crate) fn both_kinds<S: JointSpace, T: Copy>(
    (deg_key, deg): (&str, Option<Revolute<S, T>>),
    (m_key, m): (&str, Option<Prismatic<S, T>>),
) -> Result<(Sizes, Vec<T>), String> {
    let (joints, values, missing): (_, Vec<_>, _) = match (deg, m) {
        (Some(deg), Some(m)) => {
            (deg.joints, deg.values.into_iter().zip(m.values).map(|(deg, m)| deg.or(m)).collect(), m_key)
        }
        (Some(deg), None) => (deg.joints, deg.values, m_key),
        (None, Some(m)) => (m.joints, m.values, deg_key),
        (None, None) => return Err(format!("missing field `{deg_key}`")),
    };
    let names = &joints.names[S::first(joints.sizes)..];
    let value = |(value, name): (Option<T>, &String)| {
        value.ok_or_else(|| format!("missing field `{missing}`, for joint `{name}`"))
    };
    let values = values.into_iter().zip(names).map(value).collect::<Result<_, _>>()?;
    Ok((joints.sizes, values))
}
