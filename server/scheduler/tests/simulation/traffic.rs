//! What the clients ask for, and when.

use std::time::Duration;

use stereo_scheduler::Priority;

use super::dice::Dice;

/// Typical costs of the stages in ms, and how they vary.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Costs {
    pub(crate) decode: f64,
    pub(crate) base: f64,
    pub(crate) rungs: &'static [f64],
    pub(crate) step: f64,
    /// The output mesh after each rung, the first included; none if this is empty.
    pub(crate) mesh: &'static [f64],
    pub(crate) encode: f64,
    /// From the end of the encoding until the reply has left, and what else of a client's time a server can't know of.
    pub(crate) reply: f64,
    pub(crate) way: f64,
    /// Standard deviation of the logarithm of the machine's pace, which lasts for some [`PACE_LASTS_MS`].
    pub(crate) pace: f64,
    /// Standard deviation of the logarithm: of a frame, and of each of its stages.
    pub(crate) spread: f64,
    /// Probability that a stage takes much longer (page faults, another process): two to six times, by a Pareto law.
    pub(crate) hiccups: f64,
}

/// A VGA pair.
pub(crate) const VGA: Costs = Costs {
    decode: 0.1,
    base: 2.0,
    rungs: &[2.0, 2.0],
    step: 1.0,
    mesh: &[],
    encode: 0.5,
    reply: 0.0,
    way: 0.0,
    pace: 0.0,
    spread: 0.04,
    hiccups: 0.000_3,
};

/// How long a pace lasts, in ms.
pub(crate) const PACE_LASTS_MS: f64 = 30.0;

/// A VGA pair as the server was seen to treat it, on a core whose pace depends on what its neighbours do.
pub(crate) const MEASURED: Costs = Costs {
    decode: 0.01,
    base: 2.2,
    rungs: &[2.3, 0.12],
    step: 0.6,
    mesh: &[0.66, 1.55, 1.45],
    encode: 0.28,
    reply: 0.75,
    way: 0.35,
    pace: 0.15,
    spread: 0.03,
    hiccups: 0.000_3,
};

impl Costs {
    pub(crate) fn rungs(&self) -> u8 {
        u8::try_from(self.rungs.len() + 1).expect("a ladder is short")
    }

    /// Frames by the second that one worker can do in full.
    pub(crate) fn capacity(&self) -> f64 {
        let mesh = self.mesh.last().unwrap_or(&0.0) - self.mesh.first().unwrap_or(&0.0);
        1e3 / (self.mandatory() + self.rungs.iter().sum::<f64>() + mesh)
    }

    pub(crate) fn mandatory(&self) -> f64 {
        self.decode + self.base + self.mesh.first().unwrap_or(&0.0) + self.encode
    }

    pub(crate) fn draw(&self, dice: &mut Dice) -> Frame {
        let frame = (self.spread * dice.normal()).exp();
        let mut stage = |typical: f64| {
            let mut cost = typical * frame * (self.spread * dice.normal()).exp();
            if dice.uniform() < self.hiccups {
                cost *= (2.0 * dice.uniform().powf(-1.0 / 1.5)).min(6.0);
            }
            Duration::from_secs_f64(cost / 1e3)
        };
        Frame {
            decode: stage(self.decode),
            rungs: std::iter::once(&self.base)
                .chain(self.rungs)
                .map(|&typical| stage(typical))
                .collect(),
            encode: stage(self.encode),
            mesh: self.mesh.iter().map(|&typical| stage(typical)).collect(),
            reply: if self.reply > 0.0 {
                stage(self.reply)
            } else {
                Duration::ZERO
            },
        }
    }
}

/// What one frame will take; nobody knows before.
#[derive(Debug, Clone)]
pub(crate) struct Frame {
    pub(crate) decode: Duration,
    pub(crate) rungs: Vec<Duration>,
    pub(crate) encode: Duration,
    pub(crate) mesh: Vec<Duration>,
    pub(crate) reply: Duration,
}

#[derive(Debug, Clone)]
pub(crate) struct Request {
    pub(crate) at: Duration,
    pub(crate) deadline: Option<Duration>,
    pub(crate) client: u64,
    pub(crate) priority: Priority,
    pub(crate) may_halve: bool,
    pub(crate) stream: Option<u64>,
    pub(crate) frame: Frame,
}

/// How requests come.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Arrivals {
    Poisson,
    /// Gaps of a gamma law with this coefficient of variation.
    Gamma(f64),
    /// Poisson for 100 ms at three times the rate, then 200 ms nothing.
    OnOff,
    /// Cameras at 30 Hz, each with its own phase and 1 ms of jitter.
    Fleet,
}

impl Arrivals {
    pub(crate) const ALL: [(&'static str, Self); 5] = [
        ("Poisson", Self::Poisson),
        ("gamma CV 2", Self::Gamma(2.0)),
        ("gamma CV 4", Self::Gamma(4.0)),
        ("on/off", Self::OnOff),
        ("30 Hz fleet", Self::Fleet),
    ];

    /// Moments in `[from, until)`, in order, `rate` of them by the second.
    pub(crate) fn moments(self, dice: &mut Dice, rate: f64, from: f64, until: f64) -> Vec<f64> {
        let mut moments = Vec::new();
        if let Self::Fleet = self {
            let mut cameras = rate / 30.0;
            while dice.uniform() < cameras {
                cameras -= 1.0;
                let phase = dice.uniform() / 30.0;
                let mut frame = 0.0;
                while from + phase + frame / 30.0 < until {
                    moments.push(from + phase + frame / 30.0 + 0.001 * dice.uniform());
                    frame += 1.0;
                }
            }
            moments.sort_by(f64::total_cmp);
            return moments;
        }
        let mut at = from;
        loop {
            at += match self {
                Self::Gamma(cv) => dice.gamma(1.0 / (cv * cv)) / rate,
                Self::OnOff => dice.exponential() / (3.0 * rate),
                Self::Poisson | Self::Fleet => dice.exponential() / rate,
            };
            if at >= until {
                return moments;
            }
            moments.push(at);
            if let Self::OnOff = self
                && (at - from) % 0.3 > 0.1
            {
                at += 0.3 - (at - from) % 0.3;
            }
        }
    }
}

/// Budgets in ms, each as often as the others.
pub(crate) const BUDGETS: [u64; 4] = [10, 20, 50, 100];

/// Requests of `clients` clients that share the moments among them at random.
pub(crate) fn requests(
    dice: &mut Dice,
    costs: &Costs,
    moments: &[f64],
    clients: std::ops::Range<u64>,
) -> Vec<Request> {
    moments
        .iter()
        .map(|&at| {
            let at = Duration::from_secs_f64(at);
            let count = usize::try_from(clients.end - clients.start).expect("a few");
            Request {
                at,
                deadline: Some(at + Duration::from_millis(BUDGETS[dice.below(BUDGETS.len())])),
                client: clients.start + dice.below(count) as u64,
                priority: Priority::Normal,
                may_halve: false,
                stream: None,
                frame: costs.draw(dice),
            }
        })
        .collect()
}
