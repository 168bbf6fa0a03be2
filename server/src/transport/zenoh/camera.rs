//! One camera that this server serves: frames and images in, the newest to the service, results out.
//!
//! ```text
//! receive threads ── inbox ──> task: pair, check, submit ──> workers ──> task ── outbox ──> sender ──> subscribers
//!               newest frame only                newest waits, others SUPERSEDED     newest result only
//! ```
//!
//! Every frame is answered or dropped with a reason, and every image is in a frame or unpaired with a reason; all are counted.

use std::sync::Arc;
use std::time::Instant;

use futures_util::StreamExt;
use futures_util::future::BoxFuture;
use futures_util::stream::FuturesUnordered;
use stereo_proto::v1;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::task::JoinHandle;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use super::inbox::{Arrival, Inbox};
use super::pairing::{Dropped, Offered, Pairer, Stamp};
use super::payload;
use super::results::{Outbox, Results};
use super::settings::Revision;
use super::{Context, keys};
use crate::clients::Caller;
use crate::decode::Side;
use crate::job::{FrameReply, FrameRequest, PriorityClass, ReplyFormat};
use crate::service::Delivery;
use crate::status::ServiceError;
use crate::streams::{Stream, Unpaired};
use crate::wire::{Intake, SingleImage, decode_request, frame_request, single_image};

/// A camera while it is served.
pub(super) struct Camera {
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Camera {
    /// Serves a camera from now on; `None` if too many are served already.
    pub(super) fn start(context: &Arc<Context>, name: &str) -> Option<Self> {
        let stream = context.streams.open(name)?;
        let (stop, stopped) = watch::channel(false);
        let context = Arc::clone(context);
        let task = tokio::spawn(async move {
            let name = stream.camera().to_owned();
            tracing::info!(camera = name, "serving a camera");
            if let Err(why) = serve(&context, stream, stopped).await {
                tracing::error!(camera = name, %why, "a camera can't be served");
            }
            context.streams.close(&name);
            tracing::info!(camera = name, "no longer serving a camera");
        });
        Some(Self { stop, task })
    }

    /// Whether it has ended by itself.
    pub(super) fn has_ended(&self) -> bool {
        self.task.is_finished()
    }

    /// Takes no new frames, answers those under way, and ends.
    pub(super) async fn stop(self) {
        self.stop.send_replace(true);
        // An error means that it failed, which it has logged.
        drop(self.task.await);
    }
}

/// Declares everything of a camera, serves it until it is stopped, and answers what is under way.
async fn serve(
    context: &Arc<Context>,
    stream: Arc<Stream>,
    mut stopped: watch::Receiver<bool>,
) -> zenoh::Result<()> {
    let name = stream.camera().to_owned();
    let results = Results::declare(context, &name).await?;
    let results = Arc::new(results);
    let inbox = Arc::new(Inbox::default());
    let mut sources = Vec::new();
    for side in [None, Some(Side::Left), Some(Side::Right)] {
        sources.push(subscribe(context, &stream, &inbox, side).await?);
    }
    let token = context
        .session
        .liveliness()
        .declare_token(keys::owner(&name, &context.instance))
        .await?;
    let outbox = Arc::new(Outbox::default());
    let sender = tokio::spawn(Arc::clone(&results).send(Arc::clone(context), Arc::clone(&outbox)));
    let settings = context.settings.follow(&name);
    let rules = settings.borrow().settings.pairing;
    let mut room = Room {
        context,
        pairer: Pairer::new(rules),
        settings,
        results,
        outbox: &outbox,
        running: FuturesUnordered::new(),
        arrivals: 0,
        published: 0,
        stream,
    };
    room.stream.set_revision(room.settings.borrow().number);
    tokio::select! {
        () = room.run(&inbox) => {}
        _ = stopped.wait_for(|&stop| stop) => {}
    }
    for source in sources {
        source.undeclare().await?;
    }
    token.undeclare().await?;
    room.turn_away(&inbox);
    while let Some(finished) = room.running.next().await {
        room.publish(finished);
    }
    outbox.close();
    // An error means that the runtime is being torn down.
    drop(sender.await);
    Ok(())
}

/// Lets the messages of one key into the inbox.
async fn subscribe(
    context: &Arc<Context>,
    stream: &Arc<Stream>,
    inbox: &Arc<Inbox>,
    side: Option<Side>,
) -> zenoh::Result<Subscriber<()>> {
    let key = match side {
        None => keys::frames(stream.camera()),
        Some(side) => keys::images(stream.camera(), side),
    };
    let (context, stream, inbox) = (Arc::downgrade(context), Arc::clone(stream), Arc::clone(inbox));
    let session = context.upgrade().map(|context| context.session.clone());
    let session = session.ok_or("the server is stopping")?;
    session
        .declare_subscriber(key)
        .callback(move |sample| {
            let received_at = Instant::now();
            if let Some(context) = context.upgrade() {
                receive(&context, &stream, &inbox, side, &sample, received_at);
            }
        })
        .await
}

/// Runs on a receive thread.
fn receive(
    context: &Context,
    stream: &Stream,
    inbox: &Inbox,
    side: Option<Side>,
    sample: &Sample,
    received_at: Instant,
) {
    if sample.kind() == SampleKind::Delete {
        return;
    }
    stream.received(side.is_some());
    let displaced = match context.admit(sample.payload()) {
        Ok(share) => inbox
            .push(Arrival {
                side,
                payload: sample.payload().clone(),
                encoding: sample.encoding().clone(),
                attachment: sample.attachment().cloned(),
                received_at,
                share,
            })
            .map(|arrival| (arrival.side, arrival.received_at, ServiceError::Superseded)),
        Err(error) => Some((side, received_at, error)),
    };
    if let Some((side, received_at, error)) = displaced {
        refuse(context, stream, side, None, error, received_at);
    }
}

/// Something gets no result: a frame is a request that was refused, an image is only an image.
fn refuse(
    context: &Context,
    stream: &Stream,
    side: Option<Side>,
    sequence: Option<u64>,
    error: ServiceError,
    received_at: Instant,
) {
    match side {
        None => {
            let error = context.service.refuse(error, received_at, "");
            stream.dropped(sequence, &error);
        }
        Some(side) => {
            let unpaired = Unpaired {
                side,
                sequence,
                why: "refused",
                nearest: None,
            };
            stream.unpaired(&unpaired);
            stream.failed(&error);
        }
    }
}

/// A frame that the service is done with.
struct Finished {
    /// The how many-th frame of this camera it is.
    arrival: u64,
    sequence: Option<u64>,
    formats: Vec<ReplyFormat>,
    outcome: Result<FrameReply, ServiceError>,
}

/// An image on its way into a pair.
#[derive(Debug)]
struct Half {
    image: v1::Image,
    stamp: Stamp,
    received_at: Instant,
    share: OwnedSemaphorePermit,
}

/// Where one camera's frames are worked on.
struct Room<'a> {
    context: &'a Arc<Context>,
    stream: Arc<Stream>,
    settings: watch::Receiver<Arc<Revision>>,
    pairer: Pairer<Half>,
    results: Arc<Results>,
    outbox: &'a Outbox,
    running: FuturesUnordered<BoxFuture<'static, Finished>>,
    arrivals: u64,
    /// The last frame whose result was handed to the sender.
    published: u64,
}

impl Room<'_> {
    async fn run(&mut self, inbox: &Inbox) {
        loop {
            let expiry = self.pairer.next_expiry();
            let patience = async {
                match expiry {
                    Some(at) => tokio::time::sleep_until(at.into()).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                Some(finished) = self.running.next() => self.publish(finished),
                arrival = inbox.next() => self.take(arrival),
                Ok(()) = self.settings.changed() => {
                    let revision = Arc::clone(&self.settings.borrow_and_update());
                    self.pairer.set_rules(revision.settings.pairing);
                    self.stream.set_revision(revision.number);
                }
                () = patience => {
                    for dropped in self.pairer.expire(Instant::now()) {
                        self.unpaired(&dropped);
                    }
                }
            }
        }
    }

    /// What came too late to be worked on, here at least.
    fn turn_away(&mut self, inbox: &Inbox) {
        for arrival in inbox.drain() {
            let Arrival {
                side, received_at, ..
            } = arrival;
            refuse(
                self.context,
                &self.stream,
                side,
                None,
                ServiceError::Draining,
                received_at,
            );
        }
        for dropped in self.pairer.give_up() {
            self.unpaired(&dropped);
        }
    }

    fn take(&mut self, arrival: Arrival) {
        let received_at = arrival.received_at;
        match arrival.side {
            None => match message(&arrival) {
                Ok(message) => self.submit(message, received_at, vec![arrival.share]),
                Err(error) => refuse(self.context, &self.stream, None, None, error, received_at),
            },
            Some(side) => match half(arrival) {
                Ok(half) => self.pair(side, half),
                Err(error) => refuse(self.context, &self.stream, Some(side), None, error, received_at),
            },
        }
    }

    fn pair(&mut self, side: Side, half: Half) {
        let Offered { pair, dropped } = self.pairer.offer(side, half.stamp, half, Instant::now());
        for dropped in dropped {
            self.unpaired(&dropped);
        }
        if let Some((left, right)) = pair {
            self.stream.paired();
            let message = v1::StereoRequest {
                sequence: left.stamp.sequence.or(right.stamp.sequence),
                left: Some(left.image),
                right: Some(right.image),
                ..v1::StereoRequest::default()
            };
            // The frame is there as soon as its second image is.
            let received_at = left.received_at.max(right.received_at);
            self.submit(message, received_at, vec![left.share, right.share]);
        }
    }

    fn unpaired(&self, dropped: &Dropped<Half>) {
        let unpaired = Unpaired {
            side: dropped.side,
            sequence: dropped.image.stamp.sequence,
            why: dropped.why.name(),
            nearest: dropped.nearest,
        };
        self.stream.unpaired(&unpaired);
        if dropped.why == super::pairing::Unpaired::Unstamped {
            self.stream.failed(&ServiceError::Invalid(format!(
                "the {} image has neither a number nor a time: attach a stereo.v1.ImageStamp, or send a stereo.v1.Image with \
                 a timestamp",
                dropped.side
            )));
        }
    }

    /// Hands a frame to the service.
    fn submit(
        &mut self,
        message: v1::StereoRequest,
        received_at: Instant,
        shares: Vec<OwnedSemaphorePermit>,
    ) {
        self.arrivals += 1;
        let sequence = message.sequence;
        let formats = self.results.wanted(&self.stream);
        let frame = match self.frame(message, received_at, formats.clone()) {
            Ok(frame) => frame,
            Err(error) => return refuse(self.context, &self.stream, None, sequence, error, received_at),
        };
        let (service, arrival) = (Arc::clone(&self.context.service), self.arrivals);
        let outgoing = &self.context.outgoing;
        let delivery = Delivery {
            memory: outgoing.memory(outgoing.way_for_all()),
            ..Delivery::default()
        };
        self.running.push(Box::pin(async move {
            let outcome = service.submit_with(frame, delivery).await;
            drop(shares);
            Finished {
                arrival,
                sequence,
                formats,
                outcome,
            }
        }));
    }

    /// A frame of this camera with what the settings say, checked.
    fn frame(
        &self,
        mut message: v1::StereoRequest,
        received_at: Instant,
        formats: Vec<ReplyFormat>,
    ) -> Result<FrameRequest, ServiceError> {
        let camera = self.stream.camera();
        if message.camera_id.is_empty() {
            camera.clone_into(&mut message.camera_id);
        } else if message.camera_id != camera {
            return Err(ServiceError::Invalid(format!(
                "camera_id is {:?} but the key is that of camera {camera}: leave it out, or use the camera's own key",
                message.camera_id
            )));
        }
        match message.sequence {
            Some(sequence) if !self.stream.numbered(sequence) => return Err(ServiceError::Superseded),
            Some(_) => {}
            // The service tells frames of a stream by their number; without one, the order of arrival does.
            None => message.sequence = Some(self.arrivals),
        }
        let revision = Arc::clone(&self.settings.borrow());
        let settings = &revision.settings;
        if message.options.is_none() {
            message.options.clone_from(&settings.options);
        }
        message.calibration = message.calibration.or(settings.calibration);
        frame_request(
            message,
            Intake {
                received_at,
                latency_budget: settings.latency_budget,
                request_id: String::new(),
                formats,
                max_image_px: self.context.max_image_px,
                caller: Caller::Stranger(String::new()),
                priority: PriorityClass::default(),
            },
        )
    }

    /// Lets everybody know how a frame ended.
    fn publish(&mut self, finished: Finished) {
        let Finished {
            arrival,
            sequence,
            formats,
            outcome,
        } = finished;
        match outcome {
            Ok(reply) => {
                let answer = self.stream.answered(sequence, &formats, reply);
                let is_newest = arrival > self.published;
                self.published = self.published.max(arrival);
                if !is_newest || self.outbox.push(answer) {
                    self.stream.unsent();
                }
            }
            // The service has counted it.
            Err(error) => self.stream.dropped(sequence, &error),
        }
    }
}

fn message(arrival: &Arrival) -> Result<v1::StereoRequest, ServiceError> {
    payload::expect_message(&arrival.encoding, "StereoRequest")?;
    decode_request(payload::bytes(&arrival.payload))
}

/// A single image and what it says about when it was taken.
fn half(arrival: Arrival) -> Result<Half, ServiceError> {
    let SingleImage {
        image,
        sequence,
        time_ns,
    } = single_image(
        &arrival.encoding.to_string(),
        payload::bytes(&arrival.payload),
        arrival.attachment.as_ref().map(payload::bytes),
    )?;
    Ok(Half {
        stamp: Stamp { sequence, time_ns },
        image,
        received_at: arrival.received_at,
        share: arrival.share,
    })
}
