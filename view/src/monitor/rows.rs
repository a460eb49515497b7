//! Bars made of characters.

/// Draws a number in [-1, 1] as a mark on a line; a number outside is at the end of the line.
pub(super) fn mark(value: f64, width: usize) -> String {
    let Some(place) = place(value, width) else { return unknown(width) };
    (0..width)
        .map(|i| match i {
            i if i == place => '●',
            i if i == 0 || i + 1 == width => '┃',
            i if i == width / 2 => '┼',
            _ => '─',
        })
        .collect()
}

/// Draws a number in [-1, 1] as a bar from the middle.
pub(super) fn bar(value: f64, width: usize) -> String {
    let Some(place) = place(value, width) else { return unknown(width) };
    let middle = width / 2;
    let filled = middle.min(place)..=middle.max(place);
    (0..width)
        .map(|i| match i {
            // The middle alone is no bar: the value is 0.
            i if filled.contains(&i) && place != middle => '█',
            i if i == middle => '│',
            _ => '·',
        })
        .collect()
}

fn place(value: f64, width: usize) -> Option<usize> {
    let last = width.checked_sub(1)? as f64;
    value.is_finite().then(|| ((value.clamp(-1.0, 1.0) + 1.0) / 2.0 * last).round() as usize)
}

fn unknown(width: usize) -> String {
    "?".repeat(width)
}
