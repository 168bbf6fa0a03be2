//! A collector: what it is sent, by the part of OTLP's messages that is looked at (opentelemetry.proto.collector.trace.v1).

use axum::Router;
use axum::body::Bytes;
use axum::http::StatusCode;
use axum::routing::post;
use prost::Message;
use tokio::sync::mpsc;

/// Keeps whatever it is sent.
pub(crate) struct Collector {
    url: String,
    sent: mpsc::Receiver<Export>,
}

impl Collector {
    pub(crate) async fn start() -> Self {
        let (give, sent) = mpsc::channel(1000);
        let receive = move |body: Bytes| {
            let give = give.clone();
            async move {
                let export = Export::decode(body).expect("an export of OTLP");
                give.send(export).await.expect("a test that goes on");
                StatusCode::OK
            }
        };
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0")
            .await
            .expect("a free port");
        let address = listener.local_addr().expect("it is bound");
        let routes = Router::new().route("/v1/traces", post(receive));
        tokio::spawn(async move { axum::serve(listener, routes).await });
        Self {
            url: format!("http://{address}"),
            sent,
        }
    }

    pub(crate) fn url(&self) -> &str {
        &self.url
    }

    /// Everything that was sent until now, and by which program.
    pub(crate) fn sent(&mut self) -> (Option<String>, Vec<Span>) {
        let (mut program, mut spans) = (None, Vec::new());
        while let Ok(export) = self.sent.try_recv() {
            for of_program in export.resource_spans {
                let attributes = of_program.resource.unwrap_or_default().attributes;
                if let Some(Value::String(name)) = find(&attributes, "service.name") {
                    program = Some(name);
                }
                spans.extend(of_program.scope_spans.into_iter().flat_map(|scope| scope.spans));
            }
        }
        (program, spans)
    }
}

#[derive(Clone, PartialEq, prost::Message)]
struct Export {
    #[prost(message, repeated, tag = "1")]
    resource_spans: Vec<ResourceSpans>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct ResourceSpans {
    #[prost(message, optional, tag = "1")]
    resource: Option<Resource>,
    #[prost(message, repeated, tag = "2")]
    scope_spans: Vec<ScopeSpans>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Resource {
    #[prost(message, repeated, tag = "1")]
    attributes: Vec<KeyValue>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct ScopeSpans {
    #[prost(message, repeated, tag = "2")]
    spans: Vec<Span>,
}

#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Span {
    #[prost(bytes = "vec", tag = "1")]
    pub(crate) trace_id: Vec<u8>,
    #[prost(bytes = "vec", tag = "2")]
    pub(crate) span_id: Vec<u8>,
    #[prost(bytes = "vec", tag = "4")]
    pub(crate) parent_span_id: Vec<u8>,
    #[prost(string, tag = "5")]
    pub(crate) name: String,
    #[prost(fixed64, tag = "7")]
    pub(crate) start_time_unix_nano: u64,
    #[prost(fixed64, tag = "8")]
    pub(crate) end_time_unix_nano: u64,
    #[prost(message, repeated, tag = "9")]
    attributes: Vec<KeyValue>,
}

impl Span {
    pub(crate) fn attribute(&self, name: &str) -> Option<Value> {
        find(&self.attributes, name)
    }
}

#[derive(Clone, PartialEq, prost::Message)]
struct KeyValue {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(message, optional, tag = "2")]
    value: Option<AnyValue>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct AnyValue {
    #[prost(oneof = "Value", tags = "1, 3, 4")]
    value: Option<Value>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
pub(crate) enum Value {
    #[prost(string, tag = "1")]
    String(String),
    #[prost(int64, tag = "3")]
    Int(i64),
    #[prost(double, tag = "4")]
    Double(f64),
}

fn find(attributes: &[KeyValue], name: &str) -> Option<Value> {
    let named = attributes.iter().find(|attribute| attribute.key == name)?;
    named.value.as_ref()?.value.clone()
}
