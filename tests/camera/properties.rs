//! Whatever happens to a camera, each image is reported exactly once on each link. Rules CAM-2, CAM-4.

use crate::shooter::*;
use crate::support::*;
use mavstack::camera::CameraOrder;
use mavstack::dialect::*;
use proptest::prelude::*;

/// What happens.
#[derive(Clone, Debug)]
enum Event {
    Command(MavCmd, [f32; 4], bool),
    Order(u8),
    /// The camera takes an image by itself, or reports the end of one.
    Captured,
    Shutter(u8),
    Stall(u8, u64),
    Wait(u64),
}

fn event() -> impl Strategy<Value = Event> {
    let params = (0..3u8, 0..4u8, 0..5u8).prop_map(|(interval, count, sequence)| {
        [0.0, [0.0, 0.3, 1.0][usize::from(interval)], f32::from(count), f32::from(sequence)]
    });
    let id = prop_oneof![4 => Just(MavCmd::IMAGE_START_CAPTURE), 1 => Just(MavCmd::IMAGE_STOP_CAPTURE)];
    prop_oneof![
        4 => (id, params, any::<bool>()).prop_map(|(id, params, is_other)| Event::Command(id, params, is_other)),
        3 => (0..5u8).prop_map(Event::Order),
        2 => Just(Event::Captured),
        1 => (0..3u8).prop_map(Event::Shutter),
        1 => (0..2u8, 1..400u64).prop_map(|(link, time)| Event::Stall(link, time)),
        5 => (1..900u64).prop_map(Event::Wait),
    ]
}

proptest! {
    #![proptest_config(cases(150))]

    /// CAM-2, D-3: the reports of each normal link have the indices 0, 1, 2 and so on without a gap, as many as images have ended:
    /// those that were taken at once or have failed, and those whose end the camera reported or whose time was over. An image is
    /// only begun when the one before has ended.
    #[test]
    fn every_image_is_reported_once(events in prop::collection::vec(event(), 1..40)) {
        let mut site = site();
        let mut by_itself = 0;
        for event in events {
            match event {
                Event::Command(id, [a, b, c, d], is_other) => {
                    let (link, from) = if is_other { (1, OTHER_STATION) } else { (0, STATION) };
                    let message = site.gcs[link].long(id, [a, b, c, d, 0.0, 0.0, 0.0]);
                    send(&mut site, link, from, &message);
                }
                Event::Order(number) => {
                    let order = match number {
                        0 | 1 => CameraOrder::TakeImage,
                        2 => CameraOrder::StartCapture { interval: millis(700), count: 4 },
                        3 => CameraOrder::StartCapture { interval: millis(1), count: 0 },
                        _ => CameraOrder::StopCapture,
                    };
                    site.vehicle.orders.push_back(order);
                }
                Event::Captured => {
                    // Of an image that has begun, it is the end; otherwise the camera was not asked.
                    let begun = site.vehicle.exposures.len() + by_itself;
                    if begun == site.stack.camera.image_count() as usize {
                        by_itself += 1;
                    }
                    let taken = image(site.now(), site.stack.camera.image_count());
                    control(&mut site).image_captured(taken);
                }
                Event::Shutter(number) => {
                    site.vehicle.shutter = [Shutter::Instant, Shutter::Slow, Shutter::Broken][usize::from(number)];
                }
                Event::Stall(link, time) => {
                    let until = site.now() + millis(time);
                    site.uarts[usize::from(link)].stall_writes_until(until);
                }
                Event::Wait(time) => site.run_for(millis(time)),
            }
            let count = site.stack.camera.image_count() as usize;
            let ended = count - by_itself;
            prop_assert!(site.vehicle.exposures.len() - ended <= 1, "two at a time");
        }
        // The orders reach the camera before it is stopped.
        site.run_for(millis(20));
        control(&mut site).stop_capture();
        // Every image has ended then, and every link has sent its reports.
        site.run_for(secs(4));
        let count = site.stack.camera.image_count();
        prop_assert_eq!(count as usize, site.vehicle.exposures.len() + by_itself);
        prop_assert_eq!(site.stack.camera.counters().unsent, 0, "the stalls are shorter than the memory is long");
        let expected: Vec<i32> = (0..count as i32).collect();
        prop_assert_eq!(reported(&site, 0), expected.clone());
        prop_assert_eq!(reported(&site, 1), expected);
        prop_assert_eq!(control(&mut site).is_capturing(), false);
    }
}
