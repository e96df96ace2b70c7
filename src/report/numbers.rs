//! Numbers as people read them.

/// A number to some digits: to three 0.0441, 12.3, 4.56e-7.
pub fn significant(x: f64, digits: usize) -> String {
    let after_first = digits.saturating_sub(1);
    let magnitude = x.abs().log10().floor();
    if x == 0.0 || !x.is_finite() {
        return format!("{x}");
    }
    if !(-4.0..6.0).contains(&magnitude) {
        return format!("{x:.after_first$e}");
    }
    format!("{x:.*}", (after_first as f64 - magnitude).max(0.0) as usize)
}

/// A count with its thousands apart: 1,538.
pub fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits_and_counts_have_commas() {
        let texts =
            [0.0441234, 12.345, 1234.5, 4.5678e-7, 1e8, 0.0, 0.1].map(|x| significant(x, 3));
        assert_eq!(
            texts,
            ["0.0441", "12.3", "1234", "4.57e-7", "1.00e8", "0", "0.100"]
        );
        assert_eq!(
            [0, 999, 1000, 1_234_567].map(count),
            ["0", "999", "1,000", "1,234,567"]
        );
    }
}
