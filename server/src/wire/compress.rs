//! Payloads of a result, compressed: frames of Zstandard and LZ4, each readable by itself.

use std::io::Write;

use bytes::Bytes;
use lz4_flex::frame::FrameEncoder;

use crate::job::Compression;
use crate::status::ServiceError;

/// Zstandard's level: the fastest of its ordinary ones, because the time is the budget's.
const ZSTD_LEVEL: i32 = 1;

/// Replaces `payload` by its compressed form; an empty one stays empty.
pub(super) fn compress(compression: Compression, payload: &mut Bytes) -> Result<(), ServiceError> {
    if payload.is_empty() {
        return Ok(());
    }
    let compressed = match compression {
        Compression::None => return Ok(()),
        Compression::Zstd => zstd::bulk::compress(payload, ZSTD_LEVEL).map_err(|why| failed(&why))?,
        Compression::Lz4 => {
            let mut encoder = FrameEncoder::new(Vec::with_capacity(payload.len() / 2));
            encoder.write_all(payload).map_err(|why| failed(&why))?;
            encoder.finish().map_err(|why| failed(&why))?
        }
    };
    *payload = compressed.into();
    Ok(())
}

fn failed(why: &dyn std::fmt::Display) -> ServiceError {
    ServiceError::Internal(format!("compressing a result: {why}"))
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn compressed_payloads_are_smaller_and_read_back() {
        let original: Bytes = (0..100_000_u32).flat_map(|i| (i / 1000).to_le_bytes()).collect();
        let mut zstd_frame = original.clone();
        compress(Compression::Zstd, &mut zstd_frame).unwrap();
        assert!(zstd_frame.len() < original.len() / 10);
        assert_eq!(
            zstd::bulk::decompress(&zstd_frame, original.len()).unwrap(),
            original
        );
        let mut lz4_frame = original.clone();
        compress(Compression::Lz4, &mut lz4_frame).unwrap();
        assert!(lz4_frame.len() < original.len() / 10);
        let mut read = Vec::new();
        lz4_flex::frame::FrameDecoder::new(lz4_frame.as_ref())
            .read_to_end(&mut read)
            .unwrap();
        assert_eq!(read, original);
    }

    #[test]
    fn nothing_stays_nothing() {
        let mut empty = Bytes::new();
        compress(Compression::Zstd, &mut empty).unwrap();
        assert!(empty.is_empty());
    }
}
