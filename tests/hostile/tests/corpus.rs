//! Every file of the corpora, every input that was ever a fault among them, and the same changed at random.

use stereo_hostile::mutate::Mutator;
use stereo_hostile::{TARGETS, corpus};

const CHANGED: usize = 1500;

#[test]
fn no_decoder_panics_whatever_it_is_given() {
    for target in TARGETS {
        let corpus = Vec::from_iter(
            corpus::files(target.name)
                .unwrap()
                .into_iter()
                .map(|(_, bytes)| bytes),
        );
        let mut mutator = Mutator::new(20_260_101);
        let refused = (0..CHANGED)
            .filter(|_| !(target.run)(&mutator.changed(&corpus)))
            .count();
        assert!(
            refused > CHANGED / 4,
            "{} refused {refused} of {CHANGED}",
            target.name
        );
    }
}

#[test]
fn good_input_is_accepted_and_what_was_once_a_fault_survived() {
    for target in TARGETS {
        let files = corpus::files(target.name).unwrap();
        assert!(!files.is_empty(), "{} has no corpus", target.name);
        for (name, bytes) in files {
            let is_accepted = (target.run)(&bytes);
            // A camera that isn't there is refused rightly, and so may be what was found later, for a fault.
            let may_be_refused = name.starts_with("fault") || name.starts_with("absent");
            assert!(is_accepted || may_be_refused, "{}/{name}", target.name);
        }
    }
}
