#![no_main]

// The server gets ready before the first input: with this instrumentation that takes longer than an input may.
libfuzzer_sys::fuzz_target!(init: drop((stereo_hostile::target("http").run)(b"GET /livez\n\n")), |bytes: &[u8]| {
    (stereo_hostile::target("http").run)(bytes);
});
