//! HTTP/1.1 and HTTP/2, with TLS or without: one route family a file, everything wrapped by the [`envelope`].
//!
//! | route | what |
//! | --- | --- |
//! | `POST /v1/stereo` | a pair in, a result out ([`frames`]) |
//! | `POST /v1/stereo/batch` | pairs in, results out as they finish ([`batch`]) |
//! | `GET /v1/streams`, `/v1/streams/{camera}`, `../latest`, `../events` | camera streams, live ([`streams`]) |
//! | `GET /metrics` | everything that is counted ([`about`]) |
//! | `GET /openapi.json`, `/docs/` | this API's description, for programs and people ([`description`]) |
//! | `GET /` and the files below | the web page ([`console`]) |
//! | `GET /v1/info`, `/v1/schema.binpb`, `/livez`, `/readyz` | about the server ([`about`]) |
//!
//! `/metrics`, `/livez` and `/readyz` are on a listener of their own if there is one (`http.admin`), and `/metrics` nowhere else then.
//!
//! All but the last two, the page, the description and the schema are behind the [`door`].

mod about;
mod batch;
mod body;
mod connections;
mod console;
mod description;
mod door;
mod early;
mod envelope;
mod form;
mod frames;
mod negotiate;
mod refusal;
mod streams;

use std::sync::Arc;

use axum::Router;
use axum::extract::Request;
use axum::middleware::from_fn_with_state;
use axum::response::Response;
use axum::routing::{MethodRouter, get, post};

pub use self::connections::{Listener, Listening, Tls};
pub use self::form::parts_from_multipart;
use tokio::sync::Semaphore;

use crate::config::Config;
use crate::dispatch::BACKGROUND_CAPACITY;
use crate::info::Info;
use crate::service::Service;
use crate::status::ServiceError;
use crate::streams::Streams;

/// What the routes share.
struct Http {
    service: Arc<Service>,
    bodies: body::BodyLimits,
    max_image_px: u64,
    streams: Arc<Streams>,
    info: Info,
    hints: early::Hints,
    /// Requests of all batches that may wait for a worker at one time.
    batch_places: Arc<Semaphore>,
}

/// What is answered where.
pub struct Routers {
    /// At the address for everybody.
    pub public: Router,
    /// At the one for whoever runs the server, if there is one.
    pub admin: Option<Router>,
}

/// All routes in front of `service`. `simd` is the name of the instruction-set level in use.
pub fn routers(config: &Config, simd: &'static str, service: Arc<Service>, streams: Arc<Streams>) -> Routers {
    let http = Arc::new(Http {
        service,
        streams,
        bodies: body::BodyLimits::new(config),
        max_image_px: config.limits.image_pixels,
        info: Info::new(config, simd),
        hints: early::Hints::default(),
        batch_places: Arc::new(Semaphore::new(BACKGROUND_CAPACITY / 2)),
    });
    let names = Arc::new(envelope::RequestNames::new(&config.instance));
    let metrics = || only("GET, HEAD", get(about::metrics));
    let mut behind_the_door = Router::new()
        .route("/v1/stereo", only("POST", post(frames::post)))
        .route("/v1/stereo/batch", only("POST", post(batch::post)))
        .route("/v1/streams", only("GET, HEAD", get(streams::all)))
        .route("/v1/streams/{camera}", only("GET, HEAD", get(streams::one)))
        .route(
            "/v1/streams/{camera}/latest",
            only("GET, HEAD", get(streams::latest)),
        )
        .route(
            "/v1/streams/{camera}/events",
            only("GET, HEAD", get(streams::events)),
        )
        .route("/v1/info", only("GET, HEAD", get(about::info)));
    if config.http.admin.is_none() {
        behind_the_door = behind_the_door.route("/metrics", metrics());
    }
    let behind_the_door = behind_the_door.route_layer(from_fn_with_state(Arc::clone(&http), door::enter));
    let public = description::routes(console::routes(behind_the_door))
        .route("/v1/schema.binpb", only("GET, HEAD", get(about::schema)));
    let whole = |routes: Router<Arc<Http>>| {
        routes
            .route("/livez", only("GET, HEAD", get(about::live)))
            .route("/readyz", only("GET, HEAD", get(about::ready)))
            .fallback(no_such_resource)
            .layer(from_fn_with_state(Arc::clone(&names), envelope::wrap))
            .with_state(Arc::clone(&http))
    };
    let admin = config
        .http
        .admin
        .map(|_| whole(Router::new().route("/metrics", metrics())));
    Routers {
        public: whole(public),
        admin,
    }
}

/// A resource whose other methods are refused naming `expected`.
fn only(expected: &'static str, methods: MethodRouter<Arc<Http>>) -> MethodRouter<Arc<Http>> {
    methods.fallback(move |request: Request| async move {
        let path = request.uri().path().to_owned();
        let got = request.method().to_string();
        body::refuse_unread(
            request.into_body(),
            ServiceError::MethodNotAllowed { path, expected, got },
        )
    })
}

async fn no_such_resource(request: Request) -> Response {
    let path = request.uri().path().to_owned();
    body::refuse_unread(request.into_body(), ServiceError::NoSuchResource { path })
}

#[cfg(test)]
mod tests;
