//! Where metrics are entered: each with its name, unit and meaning, and all its series there from the start.

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Registry, Unit};

use super::{CLASSES, Label, Labels, OUTCOMES, latency_histogram};

/// The registry while it is filled.
pub(super) struct Book(Registry);

impl Book {
    /// An empty one; every name will begin with `prefix`.
    pub(super) fn new(prefix: &str) -> Self {
        Self(Registry::with_prefix(prefix))
    }

    /// The filled registry.
    pub(super) fn close(self) -> Registry {
        self.0
    }

    pub(super) fn plain<M: prometheus_client::registry::Metric + Clone>(
        &mut self,
        name: &str,
        help: &str,
        metric: M,
    ) -> M {
        self.0.register(name, help, metric.clone());
        metric
    }

    pub(super) fn seconds(&mut self, name: &str, help: &str, metric: Histogram) -> Histogram {
        self.0
            .register_with_unit(name, help, Unit::Seconds, metric.clone());
        metric
    }

    pub(super) fn ratio(&mut self, name: &str, help: &str, metric: Histogram) -> Histogram {
        self.0
            .register_with_unit(name, help, Unit::Ratios, metric.clone());
        metric
    }

    pub(super) fn bytes(&mut self, name: &str, help: &str) -> Gauge {
        let gauge = Gauge::default();
        self.0.register_with_unit(name, help, Unit::Bytes, gauge.clone());
        gauge
    }

    pub(super) fn counters(
        &mut self,
        name: &str,
        help: &str,
        labels: impl IntoIterator<Item = Label>,
    ) -> Family<Label, Counter> {
        let family = Family::<Label, Counter>::default();
        for label in labels {
            drop(family.get_or_create(&label));
        }
        self.plain(name, help, family)
    }

    pub(super) fn latencies(
        &mut self,
        name: &str,
        help: &str,
        labels: impl IntoIterator<Item = Label>,
    ) -> Family<Label, Histogram, fn() -> Histogram> {
        let family = Family::new_with_constructor(latency_histogram as fn() -> Histogram);
        for label in labels {
            drop(family.get_or_create(&label));
        }
        self.0
            .register_with_unit(name, help, Unit::Seconds, family.clone());
        family
    }

    pub(super) fn by_class_and_outcome(&mut self) -> Family<Labels, Counter> {
        let family = Family::<Labels, Counter>::default();
        for class in CLASSES {
            for outcome in OUTCOMES {
                drop(family.get_or_create(&[("class", class), ("outcome", outcome)]));
            }
        }
        let help = "Requests by priority class (unknown: refused before it was read) and outcome: OK, the reason of the refusal, or CANCELLED by the client";
        self.plain("requests", help, family)
    }
}
