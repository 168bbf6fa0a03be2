//! The exporter: spans wait in a bounded queue, from which a thread sends them to the collector; what finds no room is dropped.

use std::time::{Duration, Instant, SystemTime};

use async_trait::async_trait;
use axum::http::{HeaderMap, Uri};
use opentelemetry::propagation::TextMapPropagator;
use opentelemetry::trace::{Span as _, TraceContextExt, Tracer, TracerProvider};
use opentelemetry::{KeyValue, global};
use opentelemetry_http::hyper::HyperClient;
use opentelemetry_http::{Bytes, HeaderExtractor, HttpClient, HttpError, Request, Response};
use opentelemetry_otlp::{SpanExporter, WithExportConfig, WithHttpConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::SdkTracerProvider;
use tokio::runtime::Handle;
use tracing::level_filters::LevelFilter;
use tracing::{Span, Subscriber};
use tracing_opentelemetry::OpenTelemetrySpanExt;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::registry::LookupSpan;

use super::Stage;

/// Whose spans these are.
const NAME: &str = "stereod";
/// The collector's path for traces.
const PATH: &str = "/v1/traces";
/// How long the collector may take for one delivery, and a stop for the last.
const PATIENCE: Duration = Duration::from_secs(3);

/// What is under way to the collector.
pub struct Traces(SdkTracerProvider);

impl Traces {
    /// Sends spans to the collector at `endpoint` (`http://host:4318`) from now on. How many of them is up to the environment
    /// (`OTEL_TRACES_SAMPLER`), as for every program that is traced.
    ///
    /// # Errors
    /// What is wrong with `endpoint`.
    pub fn start(endpoint: &str, runtime: &Handle) -> Result<Self, String> {
        let uri: Uri = endpoint
            .parse()
            .map_err(|why| format!("{endpoint} is no address ({why})"))?;
        if uri.scheme_str() != Some("http") || uri.host().is_none() {
            return Err(format!(
                "{endpoint} is not http://HOST:PORT: traces are sent in the clear, to a collector on the same host or network"
            ));
        }
        let endpoint = match uri.path() {
            "" | "/" => format!("{}{PATH}", endpoint.trim_end_matches('/')),
            _ => endpoint.to_owned(),
        };
        let client = Client {
            hyper: HyperClient::with_default_connector(PATIENCE, None),
            runtime: runtime.clone(),
        };
        let exporter = SpanExporter::builder()
            .with_http()
            .with_http_client(client)
            .with_endpoint(endpoint)
            .with_timeout(PATIENCE)
            .build()
            .map_err(|why| why.to_string())?;
        let version = KeyValue::new("service.version", env!("CARGO_PKG_VERSION"));
        let provider = SdkTracerProvider::builder()
            .with_resource(
                Resource::builder()
                    .with_service_name(NAME)
                    .with_attribute(version)
                    .build(),
            )
            .with_batch_exporter(exporter)
            .build();
        global::set_tracer_provider(provider.clone());
        Ok(Self(provider))
    }

    /// What makes spans of tracing's, of this server's own alone.
    pub fn layer<S>(&self) -> impl Layer<S> + use<S>
    where
        S: Subscriber + for<'span> LookupSpan<'span>,
    {
        let layer = tracing_opentelemetry::layer()
            .with_tracer(self.0.tracer(NAME))
            .with_location(false)
            .with_threads(false)
            .with_tracked_inactivity(false);
        layer.with_filter(Targets::new().with_target(NAME, LevelFilter::INFO))
    }

    /// Delivers what is left, in bounded time. Blocks: not for async code.
    pub fn finish(self) {
        if let Err(why) = self.0.shutdown_with_timeout(PATIENCE) {
            tracing::warn!(%why, "the last traces were not delivered");
        }
    }
}

/// Sends on the server's runtime: the exporter's own thread has none.
#[derive(Debug)]
struct Client {
    hyper: HyperClient,
    runtime: Handle,
}

#[async_trait]
impl HttpClient for Client {
    async fn send_bytes(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let hyper = self.hyper.clone();
        let sent = self.runtime.spawn(async move { hyper.send_bytes(request).await });
        sent.await?
    }
}

pub(super) fn adopt(span: &Span, headers: &HeaderMap) {
    let parent = TraceContextPropagator::new().extract(&HeaderExtractor(headers));
    if parent.span().span_context().is_valid() {
        // Refused only where nothing is collected.
        drop(span.set_parent(parent));
    }
}

pub(super) fn stages(span: &Span, stages: &[Stage], received_at: Instant) {
    let context = span.context();
    if !context.span().span_context().is_sampled() {
        return;
    }
    let received = SystemTime::now() - received_at.elapsed();
    let tracer = global::tracer(NAME);
    for &(name, begun, took) in stages.iter().filter(|(_, _, took)| !took.is_zero()) {
        let builder = tracer.span_builder(name).with_start_time(received + begun);
        let mut stage = tracer.build_with_context(builder, &context);
        stage.end_with_timestamp(received + begun + took);
    }
}
