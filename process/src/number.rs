//! Parsers of numbers on the command line, within a range that the error message states.

/// Parser of a number from `low` to `high`.
pub fn within(low: f64, high: f64) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number = text.parse().ok().filter(|v| (low..=high).contains(v));
        number.ok_or_else(|| format!("expected a number from {low} to {high}"))
    }
}

/// Parser of a whole number from `low` to `high`.
pub fn whole<T>(low: T, high: T) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static
where
    T: std::str::FromStr + PartialOrd + std::fmt::Display + Copy + Send + Sync + 'static,
{
    move |text| {
        let number = text.parse().ok().filter(|v| (low..=high).contains(v));
        number.ok_or_else(|| format!("expected a whole number from {low} to {high}"))
    }
}
