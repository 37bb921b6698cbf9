//! Axes: their ends, their scale, and where ticks go.

/// How numbers become positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// In proportion.
    Linear,
    /// sign(x) log10(1 + |x|): numbers of every size and of both signs.
    SignedLog,
}

/// An axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// The measured quantity, with its unit.
    pub label: String,
    /// Its scale.
    pub scale: Scale,
    /// Lower end.
    pub low: f64,
    /// Upper end, above `low`.
    pub high: f64,
}

impl Axis {
    /// An axis that holds `low` to `high` with some room. An end that is not finite counts as 0.
    pub fn fit(label: &str, scale: Scale, low: f64, high: f64) -> Self {
        let [low, high] = [low, high].map(|end| if end.is_finite() { end } else { 0.0 });
        let (low, high) = if low < high { (low, high) } else { (low - 0.5, low + 0.5) };
        let axis = Self { label: label.into(), scale, low, high };
        let room = 0.04 * (axis.position(high) - axis.position(low));
        // Ends at zero stay there: nothing is drawn beyond them.
        let ends = [(low, -room), (high, room)];
        let [low, high] =
            ends.map(|(end, room)| if end == 0.0 { end } else { axis.number(axis.position(end) + room) });
        Self { low, high, ..axis }
    }

    /// An axis with just these ends.
    pub fn exact(label: &str, low: f64, high: f64) -> Self {
        Self { label: label.into(), scale: Scale::Linear, low, high }
    }

    /// Where on a linear scale `x` is drawn.
    pub fn position(&self, x: f64) -> f64 {
        match self.scale {
            Scale::Linear => x,
            Scale::SignedLog => x.signum() * x.abs().ln_1p() / std::f64::consts::LN_10,
        }
    }

    /// The inverse of [`Axis::position`].
    fn number(&self, position: f64) -> f64 {
        match self.scale {
            Scale::Linear => position,
            Scale::SignedLog => position.signum() * (position.abs() * std::f64::consts::LN_10).exp_m1(),
        }
    }

    /// Numbers to mark: round ones, some four to nine of them.
    pub fn ticks(&self) -> Vec<f64> {
        let within = |x: &f64| (self.low..=self.high).contains(x);
        if self.scale == Scale::SignedLog {
            // Of a short scale the numbers between decades are marked as well.
            for steps in [&[1.0][..], &[1.0, 2.0, 5.0]] {
                let sizes = (0..9).flat_map(|power| steps.iter().map(move |step| step * 10f64.powi(power)));
                let both = sizes.flat_map(|x| [-x, x]).chain([0.0]).filter(within);
                let mut ticks: Vec<f64> = both.collect();
                ticks.sort_unstable_by(f64::total_cmp);
                if ticks.len() >= 3 {
                    return ticks;
                }
            }
        }
        let rough = (self.high - self.low) / 6.0;
        let power = 10f64.powf(rough.log10().floor());
        let step = power * [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * power >= rough).unwrap_or(10.0);
        let first = (self.low / step).ceil() as i64;
        (first..).map(|n| n as f64 * step).take_while(within).collect()
    }
}

/// Of labels beside each other every how many can be read, if their middles are `apart` pixels from each other and their letters
/// are `size` high.
pub(super) fn every(labels: &[String], apart: i32, size: u32) -> usize {
    let longest = labels.iter().map(|label| label.chars().count()).max().unwrap_or(0);
    // Digits are somewhat wider than half their height, and two of them are left free.
    let width = 0.62 * f64::from(size) * (longest + 2) as f64;
    (width / f64::from(apart.max(1))).ceil().max(1.0) as usize
}

/// `x` as a tick's label.
pub(super) fn label(x: f64) -> String {
    let of = |unit: f64, name: &str| format!("{}{name}", round(x / unit));
    match x.abs() {
        a if a >= 1e6 => of(1e6, "M"),
        a if a >= 1e4 => of(1e3, "k"),
        _ => round(x),
    }
}

/// `x` with as many decimals as a tick needs.
fn round(x: f64) -> String {
    let text = format!("{x:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(Axis::exact("x", 0.0, 1.0).ticks().len(), 6);
        assert_eq!(Axis::exact("x", 0.0, 4500.0).ticks(), [0.0, 1000.0, 2000.0, 3000.0, 4000.0]);
        let log = Axis { scale: Scale::SignedLog, ..Axis::exact("y", -3000.0, 2.0) };
        assert_eq!(log.ticks(), [-1000.0, -100.0, -10.0, -1.0, 0.0, 1.0]);
        let short = Axis { scale: Scale::SignedLog, ..Axis::exact("y", 12.0, 520.0) };
        assert_eq!(short.ticks(), [20.0, 50.0, 100.0, 200.0, 500.0]);
        let labels = [0.0, 0.2, 500.0, 20_000.0, -1_500_000.0].map(label);
        assert_eq!(labels, ["0", "0.2", "500", "20k", "-1.5M"]);
    }

    #[test]
    fn as_many_labels_are_shown_as_there_is_room_for() {
        let labels = ["0", "2000", "4000", "6000"].map(String::from);
        assert_eq!(every(&labels, 100, 18), 1);
        assert_eq!(every(&labels, 60, 18), 2);
        assert_eq!((every(&labels, 0, 18), every(&[], 50, 18)), (67, 1));
    }

    proptest! {
        #[test]
        fn every_axis_holds_its_data_and_has_ticks(
            low in -1e7f64..1e7, span in prop_oneof![Just(0.0), 1e-3f64..1e7], log in any::<bool>(),
        ) {
            let scale = if log { Scale::SignedLog } else { Scale::Linear };
            let axis = Axis::fit("x", scale, low, low + span);
            prop_assert!(axis.low <= low && low + span <= axis.high && axis.low < axis.high);
            let ticks = axis.ticks();
            prop_assert!((1..=20).contains(&ticks.len()), "{axis:?} {ticks:?}");
            prop_assert!(ticks.windows(2).all(|w| w[0] < w[1]));
        }
    }
}
