use std::future::Future;
use std::pin::pin;
use std::task::{Context, Waker};
use std::time::{Duration, Instant};

use bytes::Bytes;

use super::*;
use crate::job::{FrameIds, FrameOptions, ImageData, ImageEncoding, PixelFormat, ReplyFormat};

/// A service whose workers are all busy for ever: it has none.
fn without_workers(capacity: usize) -> Service {
    let metrics = Arc::new(Metrics::new());
    let setting = Setting {
        workers: 1,
        capacity,
        ..Setting::default()
    };
    let dispatch = Dispatch::new(setting, Arc::clone(&metrics));
    let shared = Shared {
        dispatch: Arc::new(dispatch),
        helpers: None,
        metrics,
        instance: "test".to_owned(),
        priming: watch::Sender::new(Priming::default()),
        is_crippled: AtomicBool::new(false),
    };
    Service {
        shared: Arc::new(shared),
        clients: Arc::default(),
        workers: 0,
        pool: Mutex::new(None),
        draining: watch::Sender::new(false),
    }
}

fn request(budget: Duration) -> FrameRequest {
    let image = ImageData {
        encoding: ImageEncoding::Raw(PixelFormat::Mono8),
        width_px: 64,
        height_px: 48,
        step_bytes: 64,
        frame_id: String::new(),
        data: Bytes::from(vec![128; 64 * 48]),
    };
    FrameRequest {
        ids: FrameIds::default(),
        left: image.clone(),
        right: image,
        calibration: None,
        options: FrameOptions {
            latency_budget: budget,
            ..FrameOptions::default()
        },
        formats: vec![ReplyFormat::DisparityPng],
        received_at: Instant::now(),
        client: String::new(),
    }
}

const LONG: Duration = Duration::from_secs(60);

#[tokio::test]
async fn a_waiting_frame_expires_at_its_deadline_without_a_worker() {
    let service = without_workers(4);
    let budget = Duration::from_millis(5);
    let request = request(budget);
    let deadline = request.deadline().unwrap();
    assert_eq!(
        service.submit(request).await.unwrap_err(),
        ServiceError::Expired {
            budget,
            earliest_feasible: None
        }
    );
    assert!(Instant::now() >= deadline);
    assert_eq!(service.health().queue_depth, 0);
}

#[tokio::test]
async fn a_frame_whose_deadline_has_passed_is_refused_before_it_waits() {
    let service = without_workers(4);
    let mut late = request(Duration::from_nanos(1));
    late.received_at = Instant::now();
    assert!(matches!(
        service.submit(late).await,
        Err(ServiceError::Expired { .. })
    ));
}

#[tokio::test]
async fn a_frame_whose_client_has_gone_leaves_the_queue_at_once() {
    let service = without_workers(1);
    {
        let mut waiting = pin!(service.submit(request(LONG)));
        assert!(
            waiting
                .as_mut()
                .poll(&mut Context::from_waker(Waker::noop()))
                .is_pending()
        );
        assert_eq!(service.health().queue_depth, 1);
        let full = service.submit(request(LONG)).await.unwrap_err();
        assert!(matches!(full, ServiceError::QueueFull { limit: 1, .. }), "{full}");
    }
    assert_eq!(service.health().queue_depth, 0);
}

#[tokio::test]
async fn draining_refuses_new_frames_and_waits_for_those_admitted() {
    let service = without_workers(4);
    let mut waiting = pin!(service.submit(request(Duration::from_millis(20))));
    let mut context = Context::from_waker(Waker::noop());
    assert!(waiting.as_mut().poll(&mut context).is_pending());
    let mut draining = pin!(service.drain());
    assert!(draining.as_mut().poll(&mut context).is_pending());
    assert_eq!(
        service.submit(request(LONG)).await.unwrap_err(),
        ServiceError::Draining
    );
    assert!(service.health().is_draining);
    assert!(matches!(waiting.await, Err(ServiceError::Expired { .. })));
    draining.await;
}

#[tokio::test]
async fn frames_are_answered_by_primed_workers_and_rungs_are_told() {
    let mut config = Config::default();
    config.workers.count = 2;
    let service = Service::start(&config).unwrap();
    assert!(service.primed().await);
    assert_eq!(service.health().workers_primed, 2);
    let (told, rungs) = std::sync::mpsc::sync_channel(8);
    let on_rung: OnRung = Box::new(move |quality| told.send(quality.rung).unwrap());
    let delivery = Delivery {
        on_rung: Some(on_rung),
        ..Delivery::default()
    };
    let reply = service.submit_with(request(LONG), delivery).await.unwrap();
    assert_eq!(reply.bodies.len(), 1);
    assert_eq!(
        rungs.iter().map(u32::from).last(),
        Some(reply.report.iterations_run)
    );
    service.drain().await;
}
