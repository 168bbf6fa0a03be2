//! Replies that are files: what can be asked for, and what comes.

use std::time::Duration;

use bytes::Bytes;

/// What a reply to [`Client::match_files`](crate::Client::match_files) is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Accept {
    /// A `StereoResult` message.
    Protobuf,
    /// Report and mesh statistics as JSON.
    Json,
    /// Disparity as a 16-bit PNG, 1/256 px, 0 = invalid (KITTI's convention).
    DisparityPng,
    /// Disparity in colours, an 8-bit RGB PNG.
    ColorPng,
    /// Textured mesh, binary glTF.
    Glb,
    /// Mesh as binary PLY.
    Ply,
}

impl Accept {
    /// The media type that is asked for.
    #[must_use]
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Protobuf => stereo_proto::CONTENT_TYPE,
            Self::Json => "application/json",
            Self::DisparityPng | Self::ColorPng => "image/png",
            Self::Glb => "model/gltf-binary",
            Self::Ply => "application/ply",
        }
    }

    /// What follows the path.
    pub(crate) fn query(self) -> &'static str {
        if self == Self::ColorPng { "?view=color" } else { "" }
    }
}

/// A reply as it came.
#[derive(Debug, Clone)]
pub struct Reply {
    /// The file.
    pub body: Bytes,
    /// Its media type.
    pub content_type: String,
    /// How long the server's stages took.
    pub stages: StageTimes,
}

/// The stages of the header `Server-Timing`, in its order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct StageTimes(Vec<(String, Duration)>);

impl StageTimes {
    /// Reads the header; entries without a duration are left out.
    #[must_use]
    pub fn parse(header: &str) -> Self {
        let stage = |entry: &str| {
            let mut parts = entry.split(';').map(str::trim);
            let name = parts.next().filter(|name| !name.is_empty())?;
            let ms: f64 = parts.find_map(|part| part.strip_prefix("dur="))?.parse().ok()?;
            Some((name.to_owned(), Duration::try_from_secs_f64(ms / 1e3).ok()?))
        };
        Self(header.split(',').filter_map(stage).collect())
    }

    /// How long a stage took: `queue`, `decode`, `match`, `mesh`, `encode`.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<Duration> {
        self.0
            .iter()
            .find(|(stage, _)| stage == name)
            .map(|&(_, took)| took)
    }

    /// All stages in order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, Duration)> {
        self.0.iter().map(|(name, took)| (name.as_str(), *took))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_read_in_order_and_by_name() {
        let stages =
            StageTimes::parse("queue;dur=0.010, match;desc=\"x\";dur=5.25,odd,bad;dur=x, , mesh;dur=1");
        let names: Vec<&str> = stages.iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["queue", "match", "mesh"]);
        assert_eq!(stages.get("match"), Some(Duration::from_micros(5250)));
        assert_eq!(stages.get("encode"), None);
        assert_eq!(StageTimes::parse(""), StageTimes::default());
    }
}
