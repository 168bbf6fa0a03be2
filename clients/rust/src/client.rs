//! The client itself.

use std::io::ErrorKind;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures_util::{Stream, StreamExt, stream};
use prost::Message;
use reqwest::header::{ACCEPT, AUTHORIZATION, CONTENT_TYPE, HeaderMap};
use reqwest::multipart::{Form, Part};
use reqwest::redirect::Policy;
use reqwest::{RequestBuilder, Response, Url};
use serde::de::DeserializeOwned;
use stereo_proto::v1::{Status, StereoRequest, StereoResult};
use tokio::sync::oneshot;

use crate::access::{Access, tls_trouble};
use crate::compression::decompress;
use crate::error::status_from_problem_json;
use crate::{Accept, BatchReplies, ClientError, Info, Readiness, Reply, StageTimes, Streams};

/// How long a connection may take to be made.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// How long a whole exchange may take: the largest latency budget, and time to send and receive.
const EXCHANGE_TIMEOUT: Duration = Duration::from_secs(120);
/// How long a batch may take.
const BATCH_TIMEOUT: Duration = Duration::from_secs(24 * 3600);
/// Media type of messages one after another.
const DELIMITED: &str = "application/x-protobuf; delimited=true";
/// Time between two questions whether the server is ready.
const READY_INTERVAL: Duration = Duration::from_millis(20);

/// Talks to one server; cheap to clone, and clones share connections.
#[derive(Debug, Clone)]
pub struct Client {
    base: Url,
    http: reqwest::Client,
    /// Whether there is a certificate to be shown.
    has_identity: bool,
}

/// A pair as image files, and what is wanted of it.
#[derive(Debug, Clone, Default)]
pub struct PairFiles {
    /// Left image, PNG or JPEG.
    pub left: Bytes,
    /// Right image, PNG or JPEG, of the left one's size.
    pub right: Bytes,
    /// Options as a JSON object such as `{"latency_budget_ms": 80}`; `None` = all defaults.
    pub options_json: Option<String>,
}

impl Client {
    /// A client of the server at `url`, such as `http://127.0.0.1:8080`. Nothing is sent yet.
    ///
    /// # Errors
    /// [`ClientError::BadUrl`] if it is no http or https address.
    pub fn new(url: &str) -> Result<Self, ClientError> {
        Self::with_access(url, &Access::default())
    }

    /// A client that shows a token, trusts an authority, or has a certificate of its own.
    ///
    /// # Errors
    /// As [`new`](Self::new), and [`ClientError::BadAccess`] if something in `access` can't be used.
    pub fn with_access(url: &str, access: &Access) -> Result<Self, ClientError> {
        let bad = |why: String| ClientError::BadUrl {
            url: url.to_owned(),
            why,
        };
        let base = Url::parse(url).map_err(|why| bad(why.to_string()))?;
        let is_secure = base.scheme() == "https";
        if !(is_secure || base.scheme() == "http") || base.host_str().is_none() {
            return Err(bad(
                "it must start with http:// or https:// and name a host".to_owned()
            ));
        }
        #[expect(clippy::disallowed_methods, reason = "TLS is given")]
        let mut http = reqwest::Client::builder()
            .tls_backend_preconfigured(access.tls(is_secure)?)
            .default_headers(
                access
                    .authorization()?
                    .map(|token| (AUTHORIZATION, token))
                    .into_iter()
                    .collect(),
            )
            // A stereod sends nobody elsewhere; a token is for it alone.
            .redirect(Policy::none())
            .connect_timeout(CONNECT_TIMEOUT)
            .timeout(EXCHANGE_TIMEOUT);
        if is_this_machine(&base) {
            // A proxy from the environment would look for the server on its own machine.
            http = http.no_proxy();
        }
        let http = http.build().map_err(|why| bad(root_cause(&why)))?;
        Ok(Self {
            base,
            http,
            has_identity: access.identity_pem.is_some(),
        })
    }

    /// Matches one pair.
    ///
    /// # Errors
    /// [`ClientError::Refused`] with the server's status; the others if there is no server or none that is understood.
    pub async fn match_pair(&self, request: &StereoRequest) -> Result<StereoResult, ClientError> {
        let exchange = self
            .http
            .post(self.url("/v1/stereo")?)
            .header(CONTENT_TYPE, stereo_proto::CONTENT_TYPE)
            .header(ACCEPT, stereo_proto::CONTENT_TYPE)
            .body(request.encode_to_vec());
        let answer = self.exchange(exchange).await?;
        let mut result =
            StereoResult::decode(answer.body).map_err(|why| ClientError::Malformed(why.to_string()))?;
        decompress(&mut result)?;
        Ok(result)
    }

    /// Matches any number of pairs: requests are sent while replies come, in the order in which they are done. The server reads no faster
    /// than it works, so `requests` may be endless; it has to be polled while replies are read, which happens by itself. Dropping
    /// the replies cancels the rest.
    ///
    /// # Errors
    /// As [`match_pair`](Self::match_pair) if the batch is not taken at all.
    pub async fn match_batch<S>(&self, requests: S) -> Result<BatchReplies, ClientError>
    where
        S: Stream<Item = StereoRequest> + Send + 'static,
    {
        let sent = Arc::new(AtomicU64::new(0));
        let counting = Arc::clone(&sent);
        // Ends with an error, which closes the connection, when nobody wants the replies any more.
        let (wanted, unwanted) = oneshot::channel::<()>();
        let body = stream::unfold(Some((Box::pin(requests), unwanted)), move |state| {
            let counting = Arc::clone(&counting);
            async move {
                let (mut requests, mut unwanted) = state?;
                tokio::select! {
                    biased;
                    _ = &mut unwanted => Some((Err(std::io::Error::from(ErrorKind::BrokenPipe)), None)),
                    request = requests.next() => {
                        let bytes = Bytes::from(request?.encode_length_delimited_to_vec());
                        counting.fetch_add(1, Ordering::Relaxed);
                        Some((Ok(bytes), Some((requests, unwanted))))
                    }
                }
            }
        });
        let exchange = self
            .http
            .post(self.url("/v1/stereo/batch")?)
            .header(CONTENT_TYPE, DELIMITED)
            .header(ACCEPT, stereo_proto::CONTENT_TYPE)
            .timeout(BATCH_TIMEOUT)
            .body(reqwest::Body::wrap_stream(body));
        let answer = exchange.send().await.map_err(|error| self.failed(&error))?;
        if answer.status().is_success() {
            return Ok(BatchReplies::new(self.base.to_string(), answer, sent, wanted));
        }
        let (code, content_type, _) = head(&answer);
        let body = answer.bytes().await.map_err(|error| self.failed(&error))?;
        Err(self.refused(code, &content_type, &body))
    }

    /// Matches one pair of image files; the reply is a file of the wanted type.
    ///
    /// # Errors
    /// As [`match_pair`](Self::match_pair).
    pub async fn match_files(&self, files: PairFiles, accept: Accept) -> Result<Reply, ClientError> {
        let PairFiles {
            left,
            right,
            options_json,
        } = files;
        let mut form = Form::new()
            .part("left", Part::stream(left).file_name("left"))
            .part("right", Part::stream(right).file_name("right"));
        if let Some(options) = options_json {
            form = form.text("options", options);
        }
        let url = self.url(&format!("/v1/stereo{}", accept.query()))?;
        self.exchange(
            self.http
                .post(url)
                .header(ACCEPT, accept.media_type())
                .multipart(form),
        )
        .await
    }

    /// What the server says about itself.
    ///
    /// # Errors
    /// As [`match_pair`](Self::match_pair).
    pub async fn info(&self) -> Result<Info, ClientError> {
        let answer = self.exchange(self.http.get(self.url("/v1/info")?)).await?;
        from_json(&answer.body)
    }

    /// The camera streams that the server has seen.
    ///
    /// # Errors
    /// As [`match_pair`](Self::match_pair).
    pub async fn streams(&self) -> Result<Streams, ClientError> {
        let answer = self.exchange(self.http.get(self.url("/v1/streams")?)).await?;
        from_json(&answer.body)
    }

    /// Whether the server takes frames now, and if not, why.
    ///
    /// # Errors
    /// As [`match_pair`](Self::match_pair); that it is not ready is no error.
    pub async fn readiness(&self) -> Result<Readiness, ClientError> {
        let asked = self.http.get(self.url("/readyz")?).send().await;
        let answer = asked.map_err(|error| self.failed(&error))?;
        let (code, content_type, _) = head(&answer);
        let body = answer.bytes().await.map_err(|error| self.failed(&error))?;
        if content_type == "application/json" {
            return from_json(&body);
        }
        Err(self.refused(code, &content_type, &body))
    }

    /// Waits until the server takes frames, asking it every 20 ms.
    ///
    /// # Errors
    /// [`ClientError::NotReady`] after `timeout`, with the last answer.
    pub async fn ready(&self, timeout: Duration) -> Result<(), ClientError> {
        let start = Instant::now();
        let url = self.url("/readyz")?;
        let mut why = "no answer yet".to_owned();
        while let Some(left) = timeout.checked_sub(start.elapsed()) {
            match self.http.get(url.clone()).timeout(left).send().await {
                Ok(answer) if answer.status().is_success() => return Ok(()),
                Ok(answer) => {
                    let code = answer.status().as_u16();
                    let body = answer.text().await.unwrap_or_default();
                    why = format!("HTTP {code} {}", body.chars().take(200).collect::<String>());
                }
                Err(error) => why = root_cause(&error),
            }
            tokio::time::sleep(READY_INTERVAL.min(left)).await;
        }
        Err(ClientError::NotReady {
            url: self.base.to_string(),
            waited: timeout,
            why,
        })
    }

    fn url(&self, path: &str) -> Result<Url, ClientError> {
        self.base.join(path).map_err(|why| ClientError::BadUrl {
            url: format!("{}{path}", self.base),
            why: why.to_string(),
        })
    }

    /// Sends a request and takes the whole answer, which is a success.
    async fn exchange(&self, request: RequestBuilder) -> Result<Reply, ClientError> {
        let answer = request.send().await.map_err(|error| self.failed(&error))?;
        let (code, content_type, timing) = head(&answer);
        let is_success = answer.status().is_success();
        let body = answer.bytes().await.map_err(|error| self.failed(&error))?;
        if is_success {
            return Ok(Reply {
                body,
                content_type,
                stages: StageTimes::parse(&timing),
            });
        }
        Err(self.refused(code, &content_type, &body))
    }

    /// What the network did.
    fn failed(&self, error: &reqwest::Error) -> ClientError {
        let url = self.base.to_string();
        if let Some(why) = tls_trouble(error) {
            return ClientError::Insecure { url, why };
        }
        let why = root_cause(error);
        match error.is_connect() {
            true => ClientError::Unreachable { url, why },
            false if is_no_http(error) => ClientError::NotHttp { url },
            // By TLS 1.3, a server that misses a certificate says so after the handshake, and by closing may take its words back.
            false if self.base.scheme() == "https" && !self.has_identity => ClientError::Interrupted {
                url,
                why: format!("{why}; or it asks for a certificate of its clients, and none was given"),
            },
            false => ClientError::Interrupted { url, why },
        }
    }

    /// What the server said.
    fn refused(&self, code: u16, content_type: &str, body: &Bytes) -> ClientError {
        let url = self.base.to_string();
        refusal(content_type, body).map_or(ClientError::Unexpected { url, code }, ClientError::Refused)
    }
}

/// Whether what came is no HTTP.
fn is_no_http(error: &reqwest::Error) -> bool {
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        if error
            .downcast_ref::<hyper::Error>()
            .is_some_and(hyper::Error::is_parse)
        {
            return true;
        }
        cause = error.source();
    }
    false
}

fn is_this_machine(url: &Url) -> bool {
    let host = url.host_str().unwrap_or_default().trim_matches(['[', ']']);
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// Status code, media type and stage times of an answer.
fn head(answer: &Response) -> (u16, String, String) {
    let text = |headers: &HeaderMap, name: &str| {
        headers
            .get(name)
            .and_then(|value| value.to_str().ok())
            .unwrap_or_default()
            .to_owned()
    };
    let headers = answer.headers();
    (
        answer.status().as_u16(),
        text(headers, "content-type"),
        text(headers, "server-timing"),
    )
}

fn from_json<T: DeserializeOwned>(body: &[u8]) -> Result<T, ClientError> {
    serde_json::from_slice(body).map_err(|why| ClientError::Malformed(why.to_string()))
}

/// A refusal in either of its forms.
fn refusal(content_type: &str, body: &Bytes) -> Option<Status> {
    match content_type {
        "application/problem+json" => status_from_problem_json(body),
        stereo_proto::CONTENT_TYPE => Status::decode(body.clone()).ok(),
        _ => None,
    }
}

/// What happened at the bottom of an error; what lies above it only says that something did.
pub(crate) fn root_cause(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = error.to_string();
        cause = error.source();
    }
    // Some name a page that explains them.
    text.split(": https://").next().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests;
