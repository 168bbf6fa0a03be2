//! The API's description, `GET /openapi.json` (OpenAPI 3.1), made from the routes and types themselves, and `GET /docs/`, which shows it
//! in a browser without another network: Swagger UI comes in the binary.

use std::sync::{Arc, LazyLock};

use axum::Router;
use axum::body::Body;
use axum::extract::Path;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, LOCATION, REFERRER_POLICY};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::response::Response;
use axum::routing::get;
use bytes::Bytes;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::{Modify, OpenApi, ToSchema, openapi};
use utoipa_swagger_ui::Config;

use super::about::typed;
use super::refusal::Refusal;
use super::{Http, about, batch, frames, only, streams};
use crate::status::{Problem, ServiceError};

/// Everything that has a contract; the web page and this description have none.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "stereod",
        description = "A networked stereo microservice: a deadline in, the best disparity and mesh that fit out.",
    ),
    paths(
        frames::post,
        batch::post,
        streams::all,
        streams::one,
        streams::latest,
        streams::events,
        about::info,
        about::schema,
        about::live,
        about::ready,
        about::metrics,
    ),
    components(schemas(Problem, Binary)),
    modifiers(&Doors),
    security(("token" = [])),
    tags(
        (name = "pairs", description = "Stereo pairs in, disparity and mesh out"),
        (name = "streams", description = "Cameras that send over Zenoh, live"),
        (name = "server", description = "What the server is and how it is doing"),
    ),
)]
struct Description;

/// How a client says who it is.
struct Doors;

impl Modify for Doors {
    fn modify(&self, description: &mut openapi::OpenApi) {
        let token = HttpBuilder::new()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some(
                "A token that `stereod token NAME` has made; needed once the server's configuration has one",
            ))
            .build();
        let components = description.components.get_or_insert_default();
        components.add_security_scheme("token", SecurityScheme::Http(token));
    }
}

/// Bytes.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[expect(dead_code, reason = "only described")]
pub(super) struct Binary(String);

/// A picture of a result.
#[derive(ToSchema)]
#[schema(rename_all = "snake_case")]
#[expect(dead_code, reason = "only described: the value is read by `negotiate`")]
pub(super) enum PictureName {
    Disparity,
    Color,
}

/// A picture of a stream's result, or all of it.
#[derive(ToSchema)]
#[schema(rename_all = "snake_case")]
#[expect(dead_code, reason = "only described: the value is read by `negotiate`")]
pub(super) enum FrameViewName {
    Disparity,
    Color,
    Frame,
}

/// The description as JSON.
static JSON: LazyLock<Bytes> = LazyLock::new(|| {
    // Strings, numbers and maps of them always serialise.
    serde_json::to_vec_pretty(&Description::openapi())
        .unwrap_or_default()
        .into()
});

/// Swagger UI styles its elements one by one and draws its icons from the page itself.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// `router` with both.
pub(super) fn routes(router: Router<Arc<Http>>) -> Router<Arc<Http>> {
    // "none": nobody else is asked whether the description is valid.
    let config = Arc::new(Config::from("/openapi.json").validator_url("none"));
    let index = Arc::clone(&config);
    router
        .route("/openapi.json", only("GET, HEAD", get(json)))
        .route("/docs", only("GET, HEAD", get(to_page)))
        .route(
            "/docs/",
            only("GET, HEAD", get(move || async move { page("index.html", index) })),
        )
        .route(
            "/docs/{*file}",
            only(
                "GET, HEAD",
                get(move |Path(file): Path<String>| async move { page(&file, config) }),
            ),
        )
}

async fn json() -> Response {
    typed(StatusCode::OK, "application/json", JSON.clone())
}

async fn to_page() -> Response {
    let mut response = Response::new(Body::empty());
    *response.status_mut() = StatusCode::PERMANENT_REDIRECT;
    response
        .headers_mut()
        .insert(LOCATION, HeaderValue::from_static("docs/"));
    response
}

fn page(file: &str, config: Arc<Config<'static>>) -> Result<Response, Refusal> {
    let served = utoipa_swagger_ui::serve(file, config)
        .map_err(|why| ServiceError::Internal(format!("a page of the documentation can't be made: {why}")))?;
    let Some(served) = served else {
        let path = format!("/docs/{file}");
        return Err(ServiceError::NoSuchResource { path }.into());
    };
    let mut response = Response::new(Body::from(served.bytes.into_owned()));
    let mut set = |name: HeaderName, value: &str| {
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    };
    set(CONTENT_TYPE, &served.content_type);
    set(CACHE_CONTROL, "no-cache");
    set(CONTENT_SECURITY_POLICY, POLICY);
    set(REFERRER_POLICY, "no-referrer");
    Ok(response)
}

#[cfg(test)]
mod tests;
