use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Barrier, Mutex};
use std::thread::{self, ThreadId};

use stereo::{DisparityMap, GrayView, Level, Matcher, Params, Preset, Progress, Serial, Shape, StereoPair};

use super::*;
use crate::dispatch::{Delivery, Setting};
use crate::job::{FrameRequest, ImageData, ReplyFormat};
use crate::metrics::Metrics;
use crate::pool::{Patience, Pool, Priming, Process, Shared, dummy_request};
use crate::status::ServiceError;

fn helpers(workers: usize) -> Helpers {
    let setting = Setting {
        workers,
        capacity: 8,
        is_splitting: true,
        ..Setting::default()
    };
    let dispatch = Dispatch::new(setting, Arc::new(Metrics::new()));
    Helpers::start(workers, &dispatch).unwrap().unwrap()
}

/// The threads that ran `n` pieces, in the order of the pieces.
fn threads_of(helpers: &Helpers, n: usize) -> Vec<ThreadId> {
    let ran = Mutex::new(Vec::new());
    helpers.run(n, &|index| {
        ran.lock().unwrap().push((index, thread::current().id()));
    });
    let mut ran = ran.into_inner().unwrap();
    ran.sort_unstable_by_key(|&(index, _)| index);
    let indices: Vec<_> = ran.iter().map(|&(index, _)| index).collect();
    assert_eq!(indices, (0..n).collect::<Vec<_>>(), "each piece once");
    ran.into_iter().map(|(_, thread)| thread).collect()
}

#[test]
fn a_worker_alone_has_no_helpers() {
    let dispatch = Dispatch::new(Setting::default(), Arc::new(Metrics::new()));
    assert!(Helpers::start(1, &dispatch).unwrap().is_none());
}

#[test]
fn while_all_workers_have_work_a_frame_stays_on_its_own() {
    let helpers = helpers(3);
    assert!(
        threads_of(&helpers, 9)
            .iter()
            .all(|&id| id == thread::current().id())
    );
}

#[test]
fn those_that_have_nothing_to_do_help_at_the_same_time() {
    let helpers = helpers(3);
    let idle = Arc::clone(&helpers.idle);
    let _nothing_to_do = (idle.begin(), idle.begin());
    assert_eq!(helpers.threads(), 3);
    // Nobody gets past it unless all three are there.
    let together = Barrier::new(3);
    helpers.run(3, &|_| {
        together.wait();
    });
    assert_eq!(threads_of(&helpers, 50).len(), 50);
    assert_eq!(idle.spare(), 2, "given back");
}

#[test]
fn after_a_worker_was_given_up_as_stuck_nothing_is_split_any_more() {
    let helpers = helpers(2);
    let idle = Arc::clone(&helpers.idle);
    let _nothing_to_do = idle.begin();
    helpers.retire();
    assert!(
        threads_of(&helpers, 4)
            .iter()
            .all(|&id| id == thread::current().id())
    );
}

#[test]
fn a_panic_in_a_piece_is_the_callers_and_the_helpers_go_on() {
    let helpers = helpers(2);
    let idle = Arc::clone(&helpers.idle);
    let _nothing_to_do = idle.begin();
    for bad in 0..2 {
        let together = Barrier::new(2);
        let run = || {
            helpers.run(2, &|index| {
                together.wait();
                assert_ne!(index, bad, "a fault in the matcher, for this test");
            });
        };
        assert!(catch_unwind(AssertUnwindSafe(run)).is_err());
        assert_eq!(idle.spare(), 1, "given back");
    }
    assert_eq!(threads_of(&helpers, 20).len(), 20);
}

#[test]
fn a_panic_in_a_piece_fails_its_frame_only() {
    let metrics = Arc::new(Metrics::new());
    let setting = Setting {
        workers: 2,
        capacity: 8,
        is_splitting: true,
        ..Setting::default()
    };
    let dispatch = Arc::new(Dispatch::new(setting, Arc::clone(&metrics)));
    let shared = Arc::new(Shared {
        helpers: Helpers::start(2, &dispatch).unwrap(),
        dispatch,
        metrics,
        instance: "test".to_owned(),
        priming: tokio::sync::watch::Sender::new(Priming::default()),
        is_crippled: AtomicBool::new(false),
    });
    let process: Arc<Process> = Arc::new(|worker, run, seat| {
        if run.job.request.ids.camera_id == "bad" {
            let helpers = worker.shared().helpers.as_ref().unwrap();
            helpers.run(2, &|index| {
                assert_ne!(index, 1, "a fault in the matcher, for this test");
            });
        }
        worker.process(run, seat)
    });
    let patience = Patience {
        stuck_after: std::time::Duration::from_secs(600),
        replacements: 1,
    };
    let pool = Pool::start_with(2, Level::detect(), patience, &shared, process).unwrap();
    let send = |camera: &str| {
        while shared.dispatch.idle().spare() < 2 {
            thread::yield_now();
        }
        let mut request = FrameRequest {
            formats: vec![ReplyFormat::DisparityPng],
            ..dummy_request()
        };
        camera.clone_into(&mut request.ids.camera_id);
        let admission = shared.dispatch.submit(request, Delivery::default()).unwrap();
        admission.outcome.blocking_recv().unwrap()
    };
    let before = send("good");
    let failed = send("bad");
    let after = send("good");
    assert!(matches!(failed, Err(ServiceError::Internal(_))), "{failed:?}");
    assert_eq!(shared.metrics.worker_panics.get(), 1);
    assert_eq!(before.unwrap().bodies, after.unwrap().bodies);
    pool.join();
}

/// Disparity (1/256 px) and confidence of every rung.
fn climb(preset: Preset, join: &dyn ForkJoin) -> Vec<(Vec<u16>, Vec<u8>)> {
    let request = dummy_request();
    let view = |image: &ImageData| image.data.to_vec();
    let (width, height) = (request.left.width_px as usize, request.left.height_px as usize);
    let (left, right) = (view(&request.left), view(&request.right));
    let pair = StereoPair::new(
        GrayView::new(&left, width, height, width).unwrap(),
        GrayView::new(&right, width, height, width).unwrap(),
    )
    .unwrap();
    let shape = Shape::new(width, height).unwrap();
    let params = Params {
        preset,
        ..Params::default()
    };
    let mut matcher = Matcher::new(Level::detect(), shape, params).unwrap();
    let mut map = DisparityMap::new(shape);
    let mut rungs = Vec::new();
    let mut progress = matcher.base(pair, &mut map, join).unwrap();
    loop {
        if !matches!(progress, Progress::Working) {
            rungs.push((map.fixed().to_vec(), map.confidence().to_vec()));
        }
        if matches!(progress, Progress::Converged(_)) {
            return rungs;
        }
        progress = matcher.refine(pair, &mut map, join);
    }
}

#[test]
fn a_split_frame_is_equal_bit_for_bit_to_one_that_is_not() {
    let helpers = helpers(4);
    let idle = Arc::clone(&helpers.idle);
    for preset in [Preset::Default, Preset::Fast] {
        let alone = climb(preset, &Serial);
        assert!(climb(preset, &helpers) == alone, "{preset:?}, nobody helps");
        let guards = [(); 3].map(|()| idle.begin());
        assert!(climb(preset, &helpers) == alone, "{preset:?}, three help");
        drop(guards);
    }
}
