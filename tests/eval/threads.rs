//! `cargo eval threads`: one frame on one thread and on two.

use std::fmt::Write as _;

use anyhow::{Context, Result, ensure};
use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, ParallelIterator};
use stereo::{ForkJoin, Preset, Serial};
use stereo_tests::matching::{Bench, Matched};

use crate::method::{Method, ladder_length};
use crate::pairs::{HD, Pair, VGA};
use crate::source::{DISPARITIES, Document, Source};

const ROUNDS: u32 = 12;

/// The threads of the rayon pool that it is used in.
struct Pool;

impl ForkJoin for Pool {
    fn threads(&self) -> usize {
        rayon::current_num_threads()
    }

    fn run(&self, n: usize, piece: &(dyn Fn(usize) + Sync)) {
        (0..n).into_par_iter().with_max_len(1).for_each(piece);
    }
}

pub(crate) fn run(source: &Source) -> Result<()> {
    let cores = std::thread::available_parallelism()?.get();
    ensure!(
        cores >= 2,
        "two threads need two processors, this machine has {cores}"
    );
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build()?;
    let methods = [
        Method::new(Preset::Fast, 1),
        Method::new(Preset::Fast, ladder_length(Preset::Fast)),
        Method::new(Preset::Default, 2),
        Method::new(Preset::Default, ladder_length(Preset::Default)),
        Method::new(Preset::Paper, ladder_length(Preset::Paper)),
    ];
    let mut text = String::from(
        "| pair | preset, rungs | one thread, ms | two threads, ms | speed-up |\n|---|---|---|---|---|\n",
    );
    for (name, pair) in Pair::standard(&source.data, &[VGA, HD])? {
        for method in methods {
            let mut bench = Bench::new(&pair.left, method.params(DISPARITIES))?;
            let (one, two) = fastest(&mut bench, &pair, method.rungs, &pool)
                .with_context(|| format!("{} at {name}", method.short_name()))?;
            writeln!(
                text,
                "| {name} | {} | {one:.2} | {two:.2} | {:.2} |",
                method.short_name(),
                one / two
            )?;
        }
    }
    source.publish(Document::Figures, "threads", &text)
}

/// The fastest times in ms on one thread and on two, in turns.
fn fastest(bench: &mut Bench, pair: &Pair, rungs: u8, pool: &rayon::ThreadPool) -> Result<(f64, f64)> {
    let (left, right) = (&pair.left, &pair.right);
    let (mut one, mut two) = (f64::MAX, f64::MAX);
    let ms = |matched: &Matched| 1e3 * matched.elapsed.as_secs_f64();
    for _ in 0..ROUNDS {
        // The second run of each finds its memory warm.
        bench.run_with(left, right, rungs, &Serial)?;
        let alone = bench.run_with(left, right, rungs, &Serial)?;
        one = one.min(ms(&alone));
        let together = pool.install(|| {
            bench.run_with(left, right, rungs, &Pool)?;
            bench.run_with(left, right, rungs, &Pool)
        })?;
        two = two.min(ms(&together));
        let same = alone.disparity_px.iter().zip(&together.disparity_px);
        ensure!(
            same.into_iter().all(|(a, b)| a.to_bits() == b.to_bits()),
            "two threads gave another result than one"
        );
    }
    Ok((one, two))
}
