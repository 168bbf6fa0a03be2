//! `stereo batch`: folders of pairs as one batch over HTTP.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use futures_util::{StreamExt, stream};
use serde_json::json;
use stereo_client::ClientError;
use stereo_client::v1::batch_reply::Outcome;
use stereo_client::v1::{BatchReply, Image, StereoRequest};

use super::matching::{done, not_done};
use crate::args::BatchArgs;
use crate::failure::{Failure, Kind};
use crate::file::Target;
use crate::options::Wanted;
use crate::output::Output;
use crate::pairs::{self, Pair};
use crate::server::{Address, Place};

/// What is under way: left images by the numbers of their pairs, and the failures of those that could not be read.
#[derive(Debug, Default)]
struct UnderWay {
    left: HashMap<usize, Image>,
    unread: Vec<(usize, Failure)>,
}

pub(crate) async fn run(args: BatchArgs, place: &Place, output: Output) -> Result<(), Failure> {
    let Address::Http(url) = &place.address else {
        return Err(Failure::usage(
            "a batch goes over HTTP: give the address of one server with --server http://HOST:PORT",
        ));
    };
    let mut pairs = Vec::new();
    for folder in &args.folders {
        pairs.extend(pairs::find(folder, None)?);
    }
    if args.folders.len() > 1 {
        name_by_place(&mut pairs, args.files.output.is_some())?;
    }
    let mut wanted = Wanted::from_args(&args.matching, pairs::first_left(&pairs))?;
    let target = Target::new(&args.files, pairs.len())?;
    wanted.want_outputs(&target.parts());
    let pairs: Arc<[Pair]> = pairs.into();
    let under_way = Arc::new(Mutex::new(UnderWay::default()));
    let client = place.client(url)?;
    let mut replies = client.match_batch(requests(&pairs, wanted, &under_way)).await?;
    let bar = output.progress(Some(pairs.len() as u64));
    let (mut matched, mut worst) = (0_usize, None);
    while let Some(reply) = replies.next().await {
        let (index, outcome) = sort_out(reply?)?;
        let left = lock(&under_way).left.remove(&index);
        let (Some(pair), Some(left)) = (pairs.get(index), left) else {
            return Err(
                ClientError::Malformed(format!("a reply to pair {index}, which was not sent")).into(),
            );
        };
        let written = outcome.and_then(|result| {
            let files = target.write(&pair.name, &left, &result)?;
            Ok((result, files))
        });
        match written {
            Ok((result, files)) => {
                matched += 1;
                bar.suspend(|| done(output, pair, &result, &files))?;
            }
            Err(failure) => {
                worst = Some(failure.kind.worse(worst));
                bar.suspend(|| not_done(output, &pair.name, &failure))?;
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let unread = std::mem::take(&mut lock(&under_way).unread);
    for (index, failure) in unread {
        worst = Some(failure.kind.worse(worst));
        not_done(output, &pairs[index].name, &failure)?;
    }
    output.json(&json!({ "pairs": pairs.len(), "matched": matched }))?;
    output.text(&format!("{matched} of {} pairs matched", pairs.len()))?;
    match worst {
        None if matched < pairs.len() => Err(Failure::new(
            Kind::Unreachable,
            "the server ended the batch early: look into its log, and send the rest again",
        )),
        None => Ok(()),
        Some(kind) => Err(Failure::new(
            kind,
            format!("{} pairs were not matched: see above", pairs.len() - matched),
        )),
    }
}

/// Reads each pair when the server has room for it; one that can't be read is noted and left out.
fn requests(
    pairs: &Arc<[Pair]>,
    wanted: Wanted,
    under_way: &Arc<Mutex<UnderWay>>,
) -> impl futures_util::Stream<Item = StereoRequest> + Send + 'static {
    let (pairs, under_way) = (Arc::clone(pairs), Arc::clone(under_way));
    stream::iter(0..pairs.len()).filter_map(move |index| {
        let request = match pairs[index].read() {
            Ok((left, right)) => {
                // The image is bytes that the request shares.
                lock(&under_way).left.insert(index, left.clone());
                Some(StereoRequest {
                    request_id: index.to_string(),
                    ..wanted.request((left, right))
                })
            }
            Err(failure) => {
                lock(&under_way).unread.push((index, failure));
                None
            }
        };
        std::future::ready(request)
    })
}

/// Which pair a reply is about, and what came of it.
fn sort_out(reply: BatchReply) -> Result<(usize, Result<stereo_client::v1::StereoResult, Failure>), Failure> {
    let outcome = match reply.outcome {
        Some(Outcome::Result(result)) => Ok(*result),
        Some(Outcome::Status(status)) => Err(Failure::from(ClientError::Refused(status))),
        None => Err(ClientError::Malformed("a reply without an outcome".to_owned()).into()),
    };
    match (reply.request_id.parse(), outcome) {
        (Ok(index), outcome) => Ok((index, outcome)),
        // About the batch as a whole.
        (Err(_), Err(failure)) => Err(failure),
        (Err(_), Ok(_)) => Err(ClientError::Malformed("a result of no pair".to_owned()).into()),
    }
}

/// Names of several folders can be the same: the folder's name goes before them.
fn name_by_place(pairs: &mut [Pair], is_written: bool) -> Result<(), Failure> {
    let mut seen = HashMap::new();
    for pair in pairs {
        let parents = pair.left.ancestors().skip(1).take(2);
        let names: Vec<String> = parents
            .filter_map(|parent| Some(parent.file_name()?.to_string_lossy().into_owned()))
            .filter(|name| !["left", "image_0", "image_2", "colored_0", "im0"].contains(&name.as_str()))
            .take(1)
            .collect();
        if let Some(folder) = names.first().filter(|folder| **folder != pair.name) {
            pair.name = format!("{folder}_{}", pair.name);
        }
        if let Some(other) = seen.insert(pair.name.clone(), pair.left.clone())
            && is_written
        {
            return Err(Failure::usage(format!(
                "{} and {} would be written under the same name: send these folders one by one",
                other.display(),
                pair.left.display()
            )));
        }
    }
    Ok(())
}

fn lock(under_way: &Mutex<UnderWay>) -> std::sync::MutexGuard<'_, UnderWay> {
    // Nothing that is called while it is held panics.
    under_way.lock().unwrap_or_else(PoisonError::into_inner)
}
