//! Who is there at this moment, asked and not followed.

use std::collections::BTreeMap;

use zenoh::Session;

use crate::ClientError;

/// A camera that is announced or served.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraPresence {
    /// Its name.
    pub name: String,
    /// Whether the camera itself is there; else a server has not let it go yet.
    pub is_announced: bool,
    /// The server that serves it.
    pub served_by: Option<String>,
}

/// The keys of the liveliness tokens that there are.
pub(super) async fn alive(session: &Session, pattern: &str) -> Result<Vec<String>, ClientError> {
    let failed = |why: zenoh::Error| ClientError::Network(why.to_string());
    let replies = session.liveliness().get(pattern).await.map_err(failed)?;
    let mut keys = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        keys.extend(reply.result().ok().map(|sample| sample.key_expr().to_string()));
    }
    Ok(keys)
}

/// The cameras by their names.
pub(super) async fn cameras(session: &Session) -> Result<Vec<CameraPresence>, ClientError> {
    let announced = alive(session, "stereo/v1/camera/*").await?;
    let owned = alive(session, "stereo/v1/owner/*/*").await?;
    let mut cameras: BTreeMap<String, CameraPresence> = BTreeMap::new();
    let unknown = |name: &str| CameraPresence {
        name: name.to_owned(),
        is_announced: false,
        served_by: None,
    };
    for key in &announced {
        if let Some(name) = key.split('/').nth(3) {
            let camera = cameras.entry(name.to_owned()).or_insert_with(|| unknown(name));
            camera.is_announced = true;
        }
    }
    for key in &owned {
        let mut names = key.split('/').skip(3);
        if let (Some(name), Some(server)) = (names.next(), names.next()) {
            let camera = cameras.entry(name.to_owned()).or_insert_with(|| unknown(name));
            camera.served_by = camera.served_by.take().or_else(|| Some(server.to_owned()));
        }
    }
    Ok(cameras.into_values().collect())
}
