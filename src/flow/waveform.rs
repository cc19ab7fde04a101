//! Flow rate over a heart beat.

use serde::Serialize;

use super::FlowError;

/// Flow rate over one heart beat.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Waveform {
    /// Time, s; the first is the start, the last the end of the period.
    pub times: Vec<f64>,
    /// Flow rate of all inlets together, m³/s.
    pub flow: Vec<f64>,
}

impl Waveform {
    /// Reads `time (s), flow rate (ml/s)` rows; `#` starts a comment, one heading line is allowed.
    ///
    /// # Errors
    /// A line that is no pair of numbers, times that do not rise, fewer than two rows.
    pub fn parse_csv(text: &str) -> Result<Waveform, FlowError> {
        let (mut times, mut flow) = (Vec::new(), Vec::new());
        let mut heading = false;
        for (k, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if line.is_empty() {
                continue;
            }
            let fields: Vec<Option<f64>> = line
                .split([',', ';', '\t'])
                .map(|f| f.trim().parse().ok().filter(|x: &f64| x.is_finite()))
                .collect();
            match fields[..] {
                [Some(t), Some(q)] => {
                    if times.last().is_some_and(|&l| t <= l) {
                        return Err(FlowError::Waveform { line: k + 1, what: "the time does not rise" });
                    }
                    times.push(t);
                    flow.push(q * 1e-6);
                }
                _ if times.is_empty() && !heading => heading = true,
                _ => return Err(FlowError::Waveform { line: k + 1, what: "not a time and a flow rate" }),
            }
        }
        if times.len() < 2 {
            return Err(FlowError::Waveform { line: text.lines().count(), what: "fewer than two rows of numbers" });
        }
        Ok(Waveform { times, flow })
    }

    /// Length of the period, s.
    pub fn period(&self) -> f64 {
        self.times.last().unwrap_or(&0.0) - self.times.first().unwrap_or(&0.0)
    }

    /// Time mean, m³/s, by the trapezium rule.
    pub fn mean(&self) -> f64 {
        let area: f64 = (1..self.times.len())
            .map(|i| 0.5 * (self.flow[i] + self.flow[i - 1]) * (self.times[i] - self.times[i - 1]))
            .sum();
        area / self.period()
    }

    /// Largest magnitude, m³/s.
    pub fn peak(&self) -> f64 {
        self.flow.iter().fold(0.0, |m, q| q.abs().max(m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_waveform_is_read_with_heading_and_comments_and_bad_rows_are_named() {
        let w = Waveform::parse_csv("t,Q\n# a comment\n0, 2\n0.5; 4\n1.0,2\n").unwrap();
        assert_eq!((w.period(), w.times.len()), (1.0, 3));
        assert!((w.mean() - 3e-6).abs() < 1e-18 && (w.peak() - 4e-6).abs() < 1e-18);
        assert!(matches!(Waveform::parse_csv("0,1\n0,2\n"), Err(FlowError::Waveform { line: 2, .. })));
        assert!(matches!(Waveform::parse_csv("0,1\n1,x\n"), Err(FlowError::Waveform { line: 2, .. })));
        assert!(Waveform::parse_csv("").is_err());
    }
}
