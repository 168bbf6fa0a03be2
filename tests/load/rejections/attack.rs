//! Hostile input of many kinds.

use anyhow::{Context, Result};
use bytes::Bytes;
use prost::Message;
use stereo_client::v1;
use stereo_hostile::corpus;
use stereo_hostile::mutate::Mutator;

use super::exchange::post;
use crate::args::{Codec, Size};
use crate::frames::Frames;

const PROTOBUF: &str = "application/x-protobuf";
/// As long as a head may be.
const LONGEST_HEAD: usize = 16 << 10;

/// One kind of input.
pub(super) struct Attack {
    pub(super) name: &'static str,
    /// The next of its inputs.
    pub(super) next: Box<dyn FnMut() -> Bytes>,
}

/// All kinds, from a client with this token where one is needed to get so far.
pub(super) fn attacks(token: &str, pair: &Frames) -> Result<Vec<Attack>> {
    let raw = pair.pair(Size::VGA, Codec::Raw)?;
    let small = pair.pair(
        Size {
            width_px: 64,
            height_px: 48,
        },
        Codec::Raw,
    )?;
    let small = v1::StereoRequest::decode(small)?;
    let own = token.to_owned();
    let post = move |content_type: &str, body: &[u8]| post(&own, content_type, body);
    let claimed = |bytes: u64| {
        format!(
            "POST /v1/stereo HTTP/1.1\r\nHost: stereod\r\nAuthorization: Bearer {token}\r\nContent-Type: {PROTOBUF}\r\n\
             Content-Length: {bytes}\r\n\r\n"
        )
    };
    let unwanted = format!(
        "GET /v1/../../etc/passwd HTTP/1.1\r\nHost: stereod\r\nAuthorization: Bearer {token}\r\n\r\n"
    );
    let mut attacks = vec![
        same(
            "bytes that are no HTTP",
            b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n".to_vec(),
        ),
        same("a head that does not end", {
            // Not a byte more than it takes: what is not read would take the answer back.
            let mut head = b"GET /".to_vec();
            head.resize(LONGEST_HEAD, b'a');
            head
        }),
        same("a path that isn't there", unwanted.into_bytes()),
        same("a raw VGA pair without a token", {
            let stranger = super::exchange::post("stereod_0000", PROTOBUF, &raw);
            stranger.to_vec()
        }),
        same("a body that claims 1 TB", claimed(1 << 40).into_bytes()),
        same("a body of another type", post("text/html", b"<html>").to_vec()),
        same("a budget of 1 ns for a raw VGA pair", {
            let options = v1::Options {
                latency_budget: Some(prost_types::Duration { seconds: 0, nanos: 1 }),
                ..v1::Options::default()
            };
            let head = v1::StereoRequest {
                options: Some(options),
                ..v1::StereoRequest::default()
            };
            post(PROTOBUF, &[head.encode_to_vec().as_slice(), &raw].concat()).to_vec()
        }),
        same("a PNG that claims 60000 x 60000 px", {
            let mut request = small.clone();
            request.left = Some(claiming_png()?);
            post(PROTOBUF, &request.encode_to_vec()).to_vec()
        }),
        changing(
            "random bytes as protobuf",
            Mutator::new(1),
            vec![vec![0xff; 4096]],
            {
                let post = post.clone();
                move |bytes| post(PROTOBUF, bytes)
            },
        ),
        changing(
            "protobuf, changed at random",
            Mutator::new(2),
            files("request")?,
            {
                let post = post.clone();
                move |bytes| post(PROTOBUF, bytes)
            },
        ),
        changing("forms, changed at random", Mutator::new(3), files("form")?, {
            let post = post.clone();
            move |bytes| post("multipart/form-data; boundary=seam", bytes)
        }),
    ];
    attacks.extend(damaged_files(pair, post)?);
    Ok(attacks)
}

/// Pairs of image files that are damaged somewhere, or end too soon.
fn damaged_files(
    pair: &Frames,
    post: impl Fn(&str, &[u8]) -> Bytes + Clone + 'static,
) -> Result<Vec<Attack>> {
    let mut attacks = Vec::new();
    for (name, codec) in [
        ("VGA pairs of PNG files, damaged", Codec::Png),
        ("VGA pairs of JPEG files, cut off", Codec::Jpeg),
    ] {
        let request = v1::StereoRequest::decode(pair.pair(Size::VGA, codec)?)?;
        let left = request.left.as_ref().context("a pair has one")?.data.clone();
        let (post, mut turn) = (post.clone(), 0_usize);
        attacks.push(Attack {
            name,
            next: Box::new(move || {
                turn += 1;
                // All over the file, one place a turn.
                let at = 40 + turn * 7919 % (left.len() - 60);
                let mut request = request.clone();
                if let Some(image) = &mut request.left {
                    let mut bytes = left.to_vec();
                    match codec {
                        Codec::Jpeg => bytes.truncate(at),
                        _ => bytes[at] ^= 0x55,
                    }
                    image.data = bytes.into();
                }
                post(PROTOBUF, &request.encode_to_vec())
            }),
        });
    }
    Ok(attacks)
}

fn same(name: &'static str, request: Vec<u8>) -> Attack {
    let request = Bytes::from(request);
    Attack {
        name,
        next: Box::new(move || request.clone()),
    }
}

fn changing(
    name: &'static str,
    mut mutator: Mutator,
    corpus: Vec<Vec<u8>>,
    request: impl Fn(&[u8]) -> Bytes + 'static,
) -> Attack {
    Attack {
        name,
        next: Box::new(move || request(&mutator.changed(&corpus))),
    }
}

fn files(target: &str) -> Result<Vec<Vec<u8>>> {
    Ok(corpus::files(target)?
        .into_iter()
        .map(|(_, bytes)| bytes)
        .collect())
}

/// A file of some bytes, whose header says otherwise.
fn claiming_png() -> Result<v1::Image> {
    let mut files = files("png")?;
    let mut file = files.pop().context("there is a PNG in the corpus")?;
    // Width and height are at 16 in every PNG; its checksum is at 29.
    let side = 60_000_u32.to_be_bytes();
    file[16..20].copy_from_slice(&side);
    file[20..24].copy_from_slice(&side);
    let sum = crc(&file[12..29]).to_be_bytes();
    file[29..33].copy_from_slice(&sum);
    Ok(v1::Image {
        encoding: v1::ImageEncoding::Png.into(),
        data: file.into(),
        ..v1::Image::default()
    })
}

/// The checksum of PNG (CRC-32 of ISO 3309), bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| {
            (sum >> 1) ^ (0xedb8_8320 & (sum & 1).wrapping_neg())
        })
    })
}
