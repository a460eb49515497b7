//! Combinations of values: one of each list.

/// All combinations of one value of each list, the last list varying fastest; one empty combination of no lists.
pub(crate) fn combinations(lists: &[Vec<f64>]) -> impl Iterator<Item = Vec<f64>> {
    let number = lists.iter().fold(1, |number: usize, list| number.saturating_mul(list.len()));
    (0..number).map(move |mut index| {
        let mut combination: Vec<_> = lists
            .iter()
            .rev()
            .map(|list| {
                let value = list[index % list.len()];
                index /= list.len();
                value
            })
            .collect();
        combination.reverse();
        combination
    })
}

#[cfg(test)]
mod tests {
    use super::combinations;

    #[test]
    fn each_once() {
        let lists = [vec![1.0, 2.0], vec![5.0], vec![7.0, 8.0]];
        let all: Vec<_> = combinations(&lists).collect();
        assert_eq!(all, [[1.0, 5.0, 7.0], [1.0, 5.0, 8.0], [2.0, 5.0, 7.0], [2.0, 5.0, 8.0]]);
        assert_eq!(combinations(&[]).collect::<Vec<_>>(), [Vec::new()]);
        assert_eq!(combinations(&[Vec::new()]).count(), 0);
    }
}
