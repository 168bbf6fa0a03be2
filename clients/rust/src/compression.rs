//! Compressed payloads back to what they were.

use std::io::Read;

use bytes::Bytes;
use stereo_proto::v1::{Compression, DisparityEncoding, StereoResult};

use crate::ClientError;

/// Largest payload that is decompressed: a point cloud of 4096 x 4096 px.
const MAX_BYTES: u64 = 12 * 4096 * 4096;

/// Makes every payload of `result` what it was before the server compressed it, and says so in each part.
pub(crate) fn decompress(result: &mut StereoResult) -> Result<(), ClientError> {
    if let Some(part) = &mut result.disparity {
        let compression = part.compression();
        if part.encoding() != DisparityEncoding::Png16 {
            restore(compression, &mut part.data)?;
        }
        restore(compression, &mut part.confidence)?;
        part.set_compression(Compression::None);
    }
    if let Some(part) = &mut result.depth {
        restore(part.compression(), &mut part.data)?;
        part.set_compression(Compression::None);
    }
    if let Some(part) = &mut result.mesh {
        let compression = part.compression();
        for payload in [
            &mut part.positions,
            &mut part.indices,
            &mut part.uvs,
            &mut part.disparities,
            &mut part.colors,
        ] {
            restore(compression, payload)?;
        }
        part.set_compression(Compression::None);
    }
    if let Some(part) = &mut result.points {
        let compression = part.compression();
        restore(compression, &mut part.positions)?;
        restore(compression, &mut part.colors)?;
        part.set_compression(Compression::None);
    }
    Ok(())
}

fn restore(compression: Compression, payload: &mut Bytes) -> Result<(), ClientError> {
    if payload.is_empty() {
        return Ok(());
    }
    let malformed =
        |why: &dyn std::fmt::Display| ClientError::Malformed(format!("a compressed payload: {why}"));
    let mut plain = Vec::new();
    let read = match compression {
        Compression::Unspecified | Compression::None => return Ok(()),
        Compression::Zstd => zstd::stream::read::Decoder::new(payload.as_ref())
            .and_then(|frame| frame.take(MAX_BYTES + 1).read_to_end(&mut plain)),
        Compression::Lz4 => lz4_flex::frame::FrameDecoder::new(payload.as_ref())
            .take(MAX_BYTES + 1)
            .read_to_end(&mut plain),
    };
    read.map_err(|why| malformed(&why))?;
    if plain.len() as u64 > MAX_BYTES {
        return Err(malformed(&"it is larger than any result"));
    }
    *payload = plain.into();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_payloads_stay_and_broken_ones_are_errors() {
        let mut payload = Bytes::from_static(b"plain");
        restore(Compression::None, &mut payload).unwrap();
        assert_eq!(payload, "plain");
        for compression in [Compression::Zstd, Compression::Lz4] {
            assert!(restore(compression, &mut payload).is_err());
        }
    }

    #[test]
    fn what_would_fill_the_memory_is_refused() {
        let bomb = zstd::stream::encode_all(std::io::repeat(0).take(MAX_BYTES + 2), 1).unwrap();
        let mut payload = Bytes::from(bomb);
        assert!(restore(Compression::Zstd, &mut payload).is_err());
    }
}
