#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    (stereo_hostile::target("pixels").run)(bytes);
});
