//! The keys of version 1: what is where, and nothing about how.

/// Frames of a camera, pairs in one message.
pub(super) fn frames(camera: &str) -> String {
    format!("stereo/v1/frames/{camera}")
}

/// Single images of a camera.
pub(super) fn images(camera: &str, side: crate::decode::Side) -> String {
    format!("stereo/v1/frames/{camera}/{side}")
}

/// Whole results of a camera.
pub(super) fn results(camera: &str) -> String {
    format!("stereo/v1/results/{camera}")
}

/// One part of a camera's results: `disparity`, `mesh` or `report`.
pub(super) fn part(camera: &str, part: &str) -> String {
    format!("stereo/v1/results/{camera}/{part}")
}

/// Requests to whichever server is nearest.
pub(super) const COMPUTE: &str = "stereo/v1/compute";

/// Requests to one server.
pub(super) fn compute(instance: &str) -> String {
    format!("{COMPUTE}/{instance}")
}

/// Load of one server.
pub(super) fn load(instance: &str) -> String {
    format!("stereo/v1/load/{instance}")
}

/// Load of all servers.
pub(super) const LOADS: &str = "stereo/v1/load/*";

/// Settings of all cameras.
pub(super) const SETTINGS: &str = "stereo/v1/settings/*";

/// Settings of one camera.
pub(super) fn settings(camera: &str) -> String {
    format!("stereo/v1/settings/{camera}")
}

/// Cameras that are there (liveliness).
pub(super) const CAMERAS: &str = "stereo/v1/camera/*";

/// That a server is there (liveliness).
pub(super) fn alive(instance: &str) -> String {
    format!("stereo/v1/alive/{instance}")
}

/// Servers that are there (liveliness).
pub(super) const SERVERS: &str = "stereo/v1/alive/*";

/// That a server serves a camera (liveliness).
pub(super) fn owner(camera: &str, instance: &str) -> String {
    format!("stereo/v1/owner/{camera}/{instance}")
}

/// The last part of a key if it is a name: `[A-Za-z0-9_.-]{1,64}`.
pub(super) fn name(key: &str) -> Option<&str> {
    let name = key.rsplit('/').next()?;
    crate::config::is_name(name).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_last_part_of_a_key_and_nothing_else() {
        assert_eq!(name("stereo/v1/camera/front-1.a_B"), Some("front-1.a_B"));
        let long = format!("stereo/v1/camera/{}", "x".repeat(65));
        for bad in [
            "stereo/v1/camera/*",
            "stereo/v1/camera/",
            "a b",
            long.as_str(),
            "stereo/v1/camera/ä",
        ] {
            assert_eq!(name(bad), None, "{bad}");
        }
    }
}
