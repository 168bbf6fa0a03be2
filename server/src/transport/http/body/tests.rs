use futures_util::stream;

use super::*;

fn limits(body_bytes: u64, bytes_in_flight: u64, read_timeout: Duration) -> BodyLimits {
    let mut config = Config::default();
    config.limits.body_bytes = body_bytes;
    config.limits.bytes_in_flight = bytes_in_flight;
    config.http.body_timeout = read_timeout;
    BodyLimits::new(&config)
}

fn chunks(chunks: &[&'static [u8]]) -> Body {
    let chunks: Vec<_> = chunks
        .iter()
        .map(|chunk| Ok::<_, Infallible>(Bytes::from_static(chunk)))
        .collect();
    Body::from_stream(stream::iter(chunks))
}

fn stranger() -> Caller {
    Caller::Stranger(String::new())
}

async fn read(limits: &BodyLimits, body: Body) -> Result<Received, ServiceError> {
    limits.read(&stranger(), body, Instant::now(), None).await
}

const LONG: Duration = Duration::from_secs(60);

#[tokio::test]
async fn a_body_that_claims_too_much_is_refused_unread() {
    let limits = limits(4, 8, LONG);
    let error = read(&limits, Body::from("12345")).await.map(|_| ()).unwrap_err();
    assert!(
        matches!(&error, ServiceError::TooLarge(text) if text.contains("got 5")),
        "{error}"
    );
}

#[tokio::test]
async fn a_body_that_grows_too_large_is_refused() {
    let limits = limits(4, 8, LONG);
    let error = read(&limits, chunks(&[b"123", b"45"]))
        .await
        .map(|_| ())
        .unwrap_err();
    assert!(matches!(error, ServiceError::TooLarge(_)));
    assert!(
        read(&limits, chunks(&[b"123", b"4"]))
            .await
            .is_ok_and(|body| body.bytes == "1234")
    );
}

#[tokio::test]
async fn bodies_in_flight_share_one_bound_and_give_their_share_back() {
    let limits = limits(4, 6, LONG);
    let first = read(&limits, chunks(&[b"12", b"34"]))
        .await
        .unwrap_or_else(|error| panic!("{error}"));
    let error = read(&limits, Body::from("567")).await.map(|_| ()).unwrap_err();
    assert_eq!(error, ServiceError::BytesInFlight { limit: 6 });
    drop(first);
    assert!(read(&limits, Body::from("567")).await.is_ok());
}

#[tokio::test]
async fn a_reply_is_whole_and_counts_until_it_is_taken() {
    let limits = limits(1 << 20, 1 << 20, LONG);
    let bytes = Bytes::from(vec![7; (1 << 20) - 1]);
    let reply = limits
        .reply(&stranger(), bytes.clone(), |_| ())
        .unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(reply.size_hint().exact(), Some(bytes.len() as u64));
    assert!(matches!(
        limits.reply(&stranger(), bytes.clone(), |_| ()),
        Err(ServiceError::BytesInFlight { .. })
    ));
    assert_eq!(reply.collect().await.unwrap().to_bytes(), bytes);
    assert!(limits.reply(&stranger(), bytes, |_| ()).is_ok());
}

#[tokio::test]
async fn a_body_that_does_not_come_is_a_timeout_or_past_its_deadline() {
    let endless = || Body::from_stream(stream::pending::<Result<Bytes, Infallible>>());
    let short = Duration::from_millis(1);
    let impatient = limits(4, 8, short);
    let slow = impatient
        .read(&stranger(), endless(), Instant::now(), None)
        .await
        .map(|_| ())
        .unwrap_err();
    assert_eq!(slow, ServiceError::ReadTimeout { limit: short });
    let late = limits(4, 8, LONG)
        .read(&stranger(), endless(), Instant::now(), Some(short))
        .await
        .map(|_| ())
        .unwrap_err();
    assert_eq!(
        late,
        ServiceError::Expired {
            budget: short,
            earliest_feasible: None
        }
    );
}
