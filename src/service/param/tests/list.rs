//! PARAM_REQUEST_LIST: pacing, loss, two links.

use super::*;

/// P-10, P-11: all values in order, at 40 % of the link: one in 16 ms at 57,600 baud.
#[test]
fn a_list_is_paced() {
    let mut bench = Bench::new();
    assert_eq!(bench.send(A, &LIST), Handled::Yes);
    let (times, sent): (Vec<_>, Vec<_>) = bench.run(0, 1_000).into_iter().unzip();
    assert_eq!(sent, bench.values());
    let pauses: Vec<_> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(pauses.iter().all(|pause| (16..=17).contains(pause)), "{times:?}");
}

/// P-11: the list uses its share even if the stack is polled only every 100 ms.
#[test]
fn the_list_makes_up_for_a_late_poll() {
    let mut bench = Bench::new();
    bench.send(A, &LIST);
    let mut polls = Vec::new();
    while bench.lists[0].is_active() {
        polls.push(core::iter::from_fn(|| bench.next_listed(0)).count());
        bench.wait(70);
    }
    // 16.06 ms each: the fourth is due after 64 ms, the eighth after 112.
    assert_eq!(polls, [1, 4, 3]);
    bench.wait(10_000);
    bench.send(A, &LIST);
    assert_eq!(core::iter::from_fn(|| bench.next_listed(0)).count(), 1, "no credit for a longer pause");
}

/// P-10: a second request restarts the list.
#[test]
fn a_second_request_restarts_the_list() {
    let mut bench = Bench::new();
    bench.send(A, &LIST);
    let begun: Vec<_> = bench.run(0, 60).into_iter().map(|(_, out)| out).collect();
    assert!(!begun.is_empty() && begun.len() < usize::from(COUNT));
    bench.send(A, &LIST);
    let sent: Vec<_> = bench.run(0, 1_000).into_iter().map(|(_, out)| out).collect();
    assert_eq!(sent, bench.values());
}

/// P-10: each link has its own list.
#[test]
fn two_links_have_two_lists() {
    let mut bench = Bench::new();
    bench.send(A, &LIST);
    bench.run(0, 40);
    bench.send(B, &LIST);
    let [mut to_a, mut to_b] = [Vec::new(), Vec::new()];
    for _ in 0..1_000 {
        bench.wait(1);
        to_a.extend(bench.next_listed(0));
        to_b.extend(bench.next_listed(1));
    }
    let values = bench.values();
    assert_eq!(to_b, values);
    assert!(values.ends_with(&to_a) && to_a.len() < to_b.len());
}

/// P-12: answers to reads and sets do not wait for the end of the list.
#[test]
fn answers_are_sent_between_the_values_of_a_list() {
    let mut bench = Bench::new();
    bench.send(A, &LIST);
    bench.run(0, 20);
    bench.send(A, &read(0, ""));
    bench.send(A, &set("WORD", MavParamType::UINT16, 5));
    let (first, last) = (bench.value(0), bench.value(7));
    let sent: Vec<_> = bench.run(0, 3).into_iter().map(|(_, out)| out).collect();
    assert_eq!(sent[..2], [first, last]);
}

/// P-11: a value of the list also answers a pending read.
#[test]
fn a_listed_value_is_not_sent_twice() {
    let mut bench = Bench::new();
    bench.send(A, &LIST);
    bench.send(A, &read(0, ""));
    bench.wait(1);
    assert_eq!(bench.next_listed(0), Some(bench.value(0)));
    assert_eq!(bench.next(0), None);
}

/// After a link is reopened, its client is gone.
#[test]
fn a_reopened_link_has_no_list() {
    let mut bench = Bench::<false, true>::of(Version::V2);
    bench.send(A, &LIST);
    bench.send(A, &read(-1, "NOTHING"));
    bench.restart(0);
    assert_eq!(bench.run(0, 100), []);
}

/// P-12: over a link that loses half of the frames each way, a client gets all values by requesting the missing ones, ten at a
/// time.
#[test]
fn a_lossy_link_delivers_everything_in_the_end() {
    for seed in 0..50u32 {
        let mut bench = Bench::new();
        let mut noise = seed;
        let mut is_lost = move || {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            noise >> 31 == 0
        };
        let mut known: Vec<Option<Out>> = vec![None; usize::from(COUNT)];
        let mut rounds = 0;
        while known.iter().any(Option::is_none) {
            rounds += 1;
            assert!(rounds < 60, "seed {seed}: {known:?}");
            if known.iter().all(Option::is_none) {
                if !is_lost() {
                    bench.send(A, &LIST);
                }
            } else {
                for (index, _) in known.iter().enumerate().filter(|(_, value)| value.is_none()).take(10) {
                    if !is_lost() {
                        bench.send(A, &read(index as i16, ""));
                    }
                }
            }
            for (_, out) in bench.run(0, 1_000) {
                if let (false, &Value(index, ..)) = (is_lost(), &out) {
                    known[usize::from(index)] = Some(out);
                }
            }
        }
        let known: Vec<_> = known.into_iter().flatten().collect();
        assert_eq!(known, bench.values());
    }
}

/// On a link without a limit, there is no pause.
#[test]
fn a_link_without_limit_has_no_pause() {
    let mut bench = Bench::new();
    bench.ports[0].config.bytes_per_second = 0;
    bench.send(A, &LIST);
    for index in 0..COUNT {
        assert_eq!(bench.next_listed(0), Some(bench.value(index)));
    }
    assert_eq!(bench.lists[0].due(), Instant::NEVER);
}
