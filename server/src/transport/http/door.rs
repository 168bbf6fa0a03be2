//! The door: who a request comes from, and whether that is anybody who may ask. It stands before every route that works on frames, shows
//! streams or tells about the server; whether the server is alive and ready, its web page and its description are for everybody.

use std::sync::Arc;

use axum::extract::{Extension, Request, State};
use axum::http::HeaderMap;
use axum::http::header::AUTHORIZATION;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::Http;
use super::connections::{CertifiedNames, Peer};
use super::envelope::{ReceivedAt, RequestId};
use super::refusal::Refusal;
use crate::clients::{Caller, Clients};
use crate::status::ServiceError;

/// The scheme of HTTP that tokens are shown with (RFC 6750), in any case.
const SCHEME: &str = "bearer";

/// The layer: lets in those who may, with their [`Caller`] as an extension of the request.
pub(super) async fn enter(
    State(http): State<Arc<Http>>,
    Extension(ReceivedAt(received_at)): Extension<ReceivedAt>,
    Extension(RequestId(request_id)): Extension<RequestId>,
    mut request: Request,
    next: Next,
) -> Response {
    let extensions = request.extensions();
    let peer = extensions.get::<Peer>().copied();
    let names = extensions.get::<CertifiedNames>().cloned().unwrap_or_default();
    match admit(http.service.clients(), request.headers(), peer, &names) {
        Ok(caller) => {
            if let Some(client) = caller.client() {
                tracing::Span::current().record("client", client.name());
            }
            request.extensions_mut().insert(caller);
            next.run(request).await
        }
        Err(error) => {
            let error = http.service.refuse(error, received_at, &request_id);
            Refusal::unread(request.into_body(), error).into_response()
        }
    }
}

/// Who asks. A token counts before a certificate, which may be that of a gateway.
fn admit(
    clients: &Clients,
    headers: &HeaderMap,
    peer: Option<Peer>,
    names: &CertifiedNames,
) -> Result<Caller, ServiceError> {
    let caller = match peer {
        _ if clients.has_doors() => {
            let (known, is_wrong) = match token(headers)? {
                Some(token) => (clients.by_token(token), true),
                None => {
                    let CertifiedNames(names) = names;
                    (
                        names.iter().find_map(|name| clients.by_name(name)),
                        !names.is_empty(),
                    )
                }
            };
            Caller::Client(Arc::clone(
                known.ok_or(ServiceError::Unauthenticated { is_wrong })?,
            ))
        }
        Some(Peer(address)) => clients.by_address(address),
        None => Caller::Stranger(String::new()),
    };
    if let Some(client) = caller.client() {
        client.count_request()?;
    }
    Ok(caller)
}

/// The token that is shown.
fn token(headers: &HeaderMap) -> Result<Option<&[u8]>, ServiceError> {
    let mut given = headers.get_all(AUTHORIZATION).iter();
    let Some(first) = given.next() else {
        return Ok(None);
    };
    let wrong = ServiceError::Unauthenticated { is_wrong: true };
    let (scheme, token) = match first.as_bytes().iter().position(|&byte| byte == b' ') {
        Some(end) => first.as_bytes().split_at(end),
        None => return Err(wrong),
    };
    let is_one = given.next().is_none() && scheme.eq_ignore_ascii_case(SCHEME.as_bytes());
    is_one.then(|| Some(token.trim_ascii())).ok_or(wrong)
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;
    use crate::config::Config;

    fn shown(values: &[&'static str]) -> HeaderMap {
        values
            .iter()
            .map(|&value| (AUTHORIZATION, HeaderValue::from_static(value)))
            .collect()
    }

    #[test]
    fn a_token_is_shown_once_and_as_bearer() {
        assert_eq!(token(&shown(&[])), Ok(None));
        for value in ["Bearer abc", "bearer abc", "BEARER   abc "] {
            assert_eq!(token(&shown(&[value])), Ok(Some(b"abc".as_slice())), "{value}");
        }
        for values in [
            &["Basic abc"][..],
            &["abc"],
            &["Bearer"],
            &["Bearer abc", "Bearer abc"],
        ] {
            assert!(token(&shown(values)).is_err(), "{values:?}");
        }
    }

    #[test]
    fn where_nobody_has_a_token_everybody_is_let_in_and_known_by_address() {
        let peer = Some(Peer("192.0.2.7".parse().unwrap()));
        let nobody = CertifiedNames::default();
        let open = admit(&Clients::default(), &shown(&["Bearer abc"]), peer, &nobody);
        assert_eq!(open.unwrap().share(""), "192.0.2.7");
        let text = "[clients.lab]\ntoken_sha256 = \"ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\"\n";
        let clients = Clients::new(&Config::from_toml(text, "x").unwrap());
        let known = admit(&clients, &shown(&["Bearer abc"]), peer, &nobody).unwrap();
        assert_eq!(known.share(""), "client lab");
        for (values, is_wrong) in [(&["Bearer abd"][..], true), (&["Bearer "], true), (&[], false)] {
            let error = admit(&clients, &shown(values), peer, &nobody).unwrap_err();
            assert_eq!(error, ServiceError::Unauthenticated { is_wrong }, "{values:?}");
        }
    }
}
