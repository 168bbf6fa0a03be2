use super::*;
use crate::job::PriorityClass;
use crate::pool::dummy_request;

#[test]
fn a_frame_with_a_camera_and_a_number_is_of_a_stream() {
    let mut request = dummy_request();
    request.client = "camera front".into();
    let time = |_| Duration::ZERO;
    assert_eq!(spec(&request, 1, time).stream, None);
    request.ids.camera_id = "front".into();
    assert_eq!(
        spec(&request, 1, time).stream,
        None,
        "without a number it can't be told what is newer"
    );
    request.ids.sequence = Some(1);
    assert!(spec(&request, 1, time).stream.is_some());
}

#[test]
fn only_what_may_be_halved_has_a_half() {
    let mut request = dummy_request();
    assert_eq!(spec(&request, 1, |_| Duration::ZERO).half, None);
    request.options.allow_downscale = true;
    let half = spec(&request, 1, |_| Duration::ZERO).half.unwrap();
    assert_eq!(half.units, 320 * 240);
    request.left.height_px = 63;
    assert_eq!(
        spec(&request, 1, |_| Duration::ZERO).half,
        None,
        "its half is smaller than any image may be"
    );
}

#[test]
fn regions_to_focus_on_add_rungs_and_are_of_a_kind_of_their_own() {
    use stereo_scheduler::Kind as _;
    let mut request = dummy_request();
    let plain = work(&request, false);
    let mut focused = |weights: &[f32], width| {
        let focus = |weight: &f32| stereo::Focus {
            region: Roi {
                x: 0,
                y: 0,
                width,
                height: 100,
            },
            weight: *weight,
        };
        request.options.params.focus = weights.iter().map(focus).collect();
        work(&request, false)
    };
    let (one, two, small) = (
        focused(&[1.0, 1.0], 200),
        focused(&[1.0, 2.0], 200),
        focused(&[1.0], 20),
    );
    assert_eq!([plain, one, two].map(|work| work.rungs), [3, 4, 5]);
    assert!(plain.matching != one.matching && one.matching != two.matching);
    let apart = |other: Work<Kind>| one.matching.distance(&other.matching);
    assert!(apart(small) < apart(plain), "rungs count more than their size");
}

#[test]
fn a_split_job_is_of_another_kind_at_every_size() {
    let mut request = dummy_request();
    request.options.allow_downscale = true;
    let alone = spec(&request, 3, |_| Duration::ZERO);
    let mut split_one = alone;
    split(&mut split_one);
    assert_ne!(alone.work.matching, split_one.work.matching);
    assert_ne!(alone.half.unwrap().matching, split_one.half.unwrap().matching);
    assert_eq!(alone.weight, 3);
}

#[test]
fn what_was_never_measured_is_predicted_from_what_is_most_like_it() {
    use stereo_scheduler::Kind as _;
    let decode = |left: ImageEncoding, right: ImageEncoding, side_px: u32| {
        let mut request = dummy_request();
        (request.left.encoding, request.right.encoding) = (left, right);
        for image in [&mut request.left, &mut request.right] {
            (image.width_px, image.height_px) = (side_px, side_px);
        }
        work(&request, false).decode
    };
    let (raw, png, jpeg) = (
        ImageEncoding::Raw(PixelFormat::Mono8),
        ImageEncoding::Png,
        ImageEncoding::Jpeg,
    );
    let asked = decode(jpeg, jpeg, 2000);
    let known = [
        decode(raw, raw, 2000),
        decode(png, raw, 2000),
        decode(png, png, 640),
    ];
    let nearest = known.iter().min_by_key(|known| asked.distance(known));
    assert_eq!(
        nearest,
        Some(&known[2]),
        "files are unlike pixels, whatever their size"
    );
    assert_eq!(asked.distance(&work(&dummy_request(), false).encode), None);
}

#[test]
fn background_requests_have_no_deadline() {
    let mut request = dummy_request();
    request.options.priority = PriorityClass::Background;
    assert_eq!(spec(&request, 1, |_| Duration::ZERO).urgency, Urgency::Background);
}
