//! Settings of cameras: each server knows those of all cameras, the one that serves a camera changes and announces them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use prost::Message;
use tokio::sync::watch;

use crate::job::CameraSettings;
use crate::status::ServiceError;
use crate::wire::{camera_settings, camera_settings_to_proto, decode_camera_settings};

/// Cameras whose settings are known at one time.
const MOST_CAMERAS: usize = 1024;

/// Settings with their revision. A frame is worked on with one such snapshot.
#[derive(Debug, Default)]
pub(super) struct Revision {
    pub(super) settings: CameraSettings,
    pub(super) number: u64,
}

impl Revision {
    /// As the wire has it.
    pub(super) fn encoded(&self) -> Vec<u8> {
        camera_settings_to_proto(&self.settings, self.number).encode_to_vec()
    }
}

/// Settings of all cameras that have some.
pub(super) struct SettingsBook {
    by_camera: Mutex<BTreeMap<String, watch::Sender<Arc<Revision>>>>,
}

impl SettingsBook {
    /// Those of the configuration.
    pub(super) fn new(configured: BTreeMap<String, CameraSettings>) -> Self {
        let senders = configured.into_iter().map(|(camera, settings)| {
            let first = Revision { settings, number: 0 };
            (camera, watch::Sender::new(Arc::new(first)))
        });
        Self {
            by_camera: Mutex::new(senders.collect()),
        }
    }

    /// The settings of a camera, and every change of them.
    pub(super) fn follow(&self, camera: &str) -> watch::Receiver<Arc<Revision>> {
        let mut book = self.lock();
        book.entry(camera.to_owned()).or_default().subscribe()
    }

    /// The settings of a camera.
    pub(super) fn read(&self, camera: &str) -> Arc<Revision> {
        let book = self.lock();
        book.get(camera)
            .map(|sender| Arc::clone(&sender.borrow()))
            .unwrap_or_default()
    }

    /// Everything that was ever set.
    pub(super) fn all(&self) -> Vec<(String, Arc<Revision>)> {
        let book = self.lock();
        let known = book
            .iter()
            .map(|(camera, sender)| (camera.clone(), Arc::clone(&sender.borrow())));
        known.filter(|(_, revision)| revision.number > 0).collect()
    }

    /// Replaces the settings of a camera, all at once: frames that come from now on are worked on with them.
    pub(super) fn set(&self, camera: &str, payload: Bytes) -> Result<Arc<Revision>, ServiceError> {
        let settings = camera_settings(decode_camera_settings(payload)?)?;
        let mut book = self.lock();
        if book.len() >= MOST_CAMERAS && !book.contains_key(camera) {
            return Err(ServiceError::TooLarge(format!(
                "the settings of {MOST_CAMERAS} cameras are known already: use fewer cameras"
            )));
        }
        let sender = book.entry(camera.to_owned()).or_default();
        let number = sender.borrow().number + 1;
        let next = Arc::new(Revision { settings, number });
        sender.send_replace(Arc::clone(&next));
        Ok(next)
    }

    /// Another server has announced settings; older ones than those known are left alone.
    pub(super) fn learn(&self, camera: &str, payload: Bytes) -> Result<(), ServiceError> {
        let wire = decode_camera_settings(payload)?;
        let number = wire.revision;
        let settings = camera_settings(wire)?;
        let mut book = self.lock();
        if book.len() >= MOST_CAMERAS && !book.contains_key(camera) {
            return Ok(());
        }
        let sender = book.entry(camera.to_owned()).or_default();
        if sender.borrow().number < number {
            sender.send_replace(Arc::new(Revision { settings, number }));
        }
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, watch::Sender<Arc<Revision>>>> {
        // Nothing that is called while it is held panics.
        self.by_camera.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use stereo_proto::v1;

    use super::*;

    fn payload(focal_px: f64, revision: u64) -> Bytes {
        let calibration = v1::Calibration {
            focal_px,
            baseline_m: 0.1,
            ..v1::Calibration::default()
        };
        let settings = v1::CameraSettings {
            calibration: Some(calibration),
            revision,
            ..v1::CameraSettings::default()
        };
        settings.encode_to_vec().into()
    }

    fn focal_px(revision: &Revision) -> f64 {
        revision
            .settings
            .calibration
            .map_or(0.0, |calibration| calibration.focal_px)
    }

    #[test]
    fn a_change_is_whole_counted_and_seen_by_who_follows() {
        let book = SettingsBook::new(BTreeMap::new());
        let followed = book.follow("front");
        assert_eq!(book.set("front", payload(500.0, 77)).unwrap().number, 1);
        assert_eq!(
            (focal_px(&followed.borrow()), followed.borrow().number),
            (500.0, 1)
        );
        let error = book.set("front", payload(-1.0, 0)).unwrap_err();
        assert!(error.to_string().contains("focal_px"), "{error}");
        assert!(book.set("front", Bytes::from_static(b"\xff")).is_err());
        assert_eq!(book.read("front").number, 1, "what is refused changes nothing");
        assert_eq!(book.read("other").number, 0);
    }

    #[test]
    fn what_others_announce_counts_only_if_it_is_newer() {
        let book = SettingsBook::new(BTreeMap::new());
        book.learn("front", payload(500.0, 5)).unwrap();
        book.learn("front", payload(400.0, 4)).unwrap();
        assert_eq!(focal_px(&book.read("front")), 500.0);
        assert_eq!(book.set("front", payload(600.0, 0)).unwrap().number, 6);
    }
}
