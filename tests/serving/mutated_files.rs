//! Damaged files by the hundred: every one gets an answer or a refusal, none harms the server.

use serde_json::json;

use crate::conversation::{PAIR, Server};
use crate::files::jpeg;

/// A small seeded generator: the same damage in every run.
struct Random(u64);

impl Random {
    /// A number below `end`.
    fn below(&mut self, end: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        usize::try_from(self.0 % end as u64).expect("below a usize")
    }
}

/// `file` with a few bytes overwritten, and sometimes a piece removed or doubled; half of the damage is near the start,
/// where the headers are.
fn damaged(file: &[u8], random: &mut Random) -> Vec<u8> {
    let mut file = file.to_vec();
    for _ in 0..=random.below(8) {
        let end = if random.below(2) == 0 {
            file.len().min(200)
        } else {
            file.len()
        };
        let at = random.below(end);
        file[at] = random.below(256).to_le_bytes()[0];
    }
    let at = random.below(file.len());
    match random.below(4) {
        0 => file.truncate(at),
        1 => drop(file.drain(at..(at + 40).min(file.len()))),
        2 => file.extend_from_within(at..),
        _ => {}
    }
    file
}

#[tokio::test]
async fn damaged_png_and_jpeg_files_never_harm_the_server() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let jpegs = (jpeg(&PAIR.rendered.left), jpeg(&PAIR.rendered.right));
    for round in 0..150 {
        let (left, right) = if round % 2 == 0 {
            (&PAIR.left, &PAIR.right)
        } else {
            (&jpegs.0, &jpegs.1)
        };
        let left = damaged(left, &mut random);
        let files: [(&str, &[u8]); 2] = [("left", &left), ("right", right)];
        let reply = server
            .post_form("", "image/png", &files, Some(json!({ "max_iterations": 1 })))
            .await;
        assert!(
            [200, 400, 413, 422].contains(&reply.status),
            "round {round}: {} {}",
            reply.status,
            reply.text()
        );
        if reply.status != 200 {
            reply.assert_refused(reply.status, &["left"]);
        }
        if round % 50 == 49 {
            server.assert_serves(&good).await;
        }
    }
}
