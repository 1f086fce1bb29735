//! From a cut to coverage: soft edges where the photograph has them, by the guided filter (He, Sun and Tang, "Guided
//! Image Filtering", 2013) in a band along the outline.

/// What a neighbourhood's contrast (variance of grey values) must exceed before an edge is followed.
const NOISE: f32 = 1e-4;

/// Coverage in [0, 1] from `inside` (0 or 1, or between after enlarging), both `width · height`; `grey` is the
/// photograph's. Pixels farther than `radius` from the outline keep what they are.
pub(super) fn soften(
    (width, height): (usize, usize),
    grey: &[f32],
    inside: &[f32],
    radius: usize,
) -> Vec<f32> {
    let mean = |values: &[f32]| box_mean(values, (width, height), radius);
    let product =
        |a: &[f32], b: &[f32]| -> Vec<f32> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let (guide, target) = (mean(grey), mean(inside));
    let squares = mean(&product(grey, grey));
    let common = mean(&product(grey, inside));
    let mut slope = vec![0.0; grey.len()];
    let mut offset = vec![0.0; grey.len()];
    for i in 0..grey.len() {
        let variance = (squares[i] - guide[i] * guide[i]).max(0.0);
        slope[i] = (common[i] - guide[i] * target[i]) / (variance + NOISE);
        offset[i] = target[i] - slope[i] * guide[i];
    }
    let (slope, offset) = (mean(&slope), mean(&offset));
    let soft = |i: usize| {
        let whole = target[i] <= 0.0 || target[i] >= 1.0;
        let value = if whole {
            inside[i]
        } else {
            slope[i] * grey[i] + offset[i]
        };
        value.clamp(0.0, 1.0)
    };
    (0..grey.len()).map(soft).collect()
}

/// Means over squares of 2·`radius` + 1 pixels, as far as they lie in the image.
fn box_mean(values: &[f32], (width, height): (usize, usize), radius: usize) -> Vec<f32> {
    let rows = line_means(values, (width, height), (1, width), radius);
    line_means(&rows, (height, width), (width, 1), radius)
}

/// Means along lines of `length` values `step` apart, of which there are `lines`, `stride` apart.
fn line_means(
    values: &[f32],
    (length, lines): (usize, usize),
    (step, stride): (usize, usize),
    radius: usize,
) -> Vec<f32> {
    let mut means = vec![0.0; values.len()];
    for line in 0..lines {
        let at = |i: usize| line * stride + i * step;
        let mut sum: f64 = (0..radius.min(length))
            .map(|i| f64::from(values[at(i)]))
            .sum();
        for i in 0..length {
            if i + radius < length {
                sum += f64::from(values[at(i + radius)]);
            }
            if i > radius {
                sum -= f64::from(values[at(i - radius - 1)]);
            }
            let count = (i + radius).min(length - 1) - i.saturating_sub(radius) + 1;
            means[at(i)] = (sum / count as f64) as f32;
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_become_as_soft_as_the_photograph() {
        // A ramp of four pixels between dark object and bright background; the cut is hard, in its middle.
        let (width, height) = (40, 12);
        let ramp = |x: usize| ((x as f32 - 17.5) / 4.0).clamp(0.0, 1.0);
        let grey: Vec<f32> = (0..width * height).map(|i| ramp(i % width)).collect();
        let hard = |i: usize| f32::from(u8::from(i % width < 20));
        let inside: Vec<f32> = (0..width * height).map(hard).collect();
        let alpha = soften((width, height), &grey, &inside, 4);
        for x in 0..width {
            let found = alpha[6 * width + x];
            assert!((found - (1.0 - ramp(x))).abs() < 0.12, "{x}: {found}");
        }
        // Without an edge to follow, far pixels stay and values stay in range.
        assert_eq!((alpha[0], alpha[width - 1]), (1.0, 0.0));
        let flat = soften((width, height), &vec![0.5; width * height], &inside, 4);
        assert!(flat.iter().all(|a| (0.0..=1.0).contains(a)));
        assert_eq!((flat[0], flat[width - 1]), (1.0, 0.0));
    }
}
