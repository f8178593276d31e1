//! Open files are leases: rules X-3 and F-6.

use super::operators::Field;
use super::plans::items;
use super::*;
use MavFtpOpcode as Op;
use mavstack::PlanType;
use mavstack::dialect::{MissionCount, MissionItemInt};
use support::plan_file::file;

/// Two that hold the sessions, and one that waits.
const HOLDERS: [Client; 2] = [Client::new(STATION, 0, 0), Client::new(Address::new(200, 1), 0, 7)];
const WAITING: Client = Client::new(OTHER_STATION, 1, 3);

/// A vehicle with two links of 57,600 bit/s, where a twentieth is 288 bytes/s.
fn slow_world() -> Shelf {
    let link = LinkConfig::uart(57_600).with_streams(StreamProfile::Off);
    let mut world = Shelf::of(Setup { links: [link; 2], step: millis(5), ..Setup::new() });
    world.vehicle.files.content.insert("log.bin".to_string(), pattern(100_000));
    world.run_for(millis(10));
    world
}

/// Opens the file for all who hold a session.
fn holders(world: &mut Shelf) -> [Client; 2] {
    let mut holders = HOLDERS;
    for holder in &mut holders {
        holder.open(world, "log.bin").unwrap();
    }
    holders
}

/// 27 bytes every two seconds from each of two clients kept both sessions for ever: 0 of 30 opens of others. Now it is 30 of 30,
/// each within 12 s, although the two open their files again at once.
#[test]
fn trickle_keeps_no_session() {
    let mut world = slow_world();
    let mut waiting = WAITING;
    let mut trickling = holders(&mut world);
    let mut second = 0;
    let mut longest = 0;
    for round in 0..30 {
        let begin = second;
        while waiting.open(&mut world, "log.bin").is_err() {
            assert!(second - begin < 12, "round {round}");
            if second % 2 == 0 {
                for client in &mut trickling {
                    if client.read(&mut world, 0, 9).is_err() {
                        client.open(&mut world, "log.bin").unwrap();
                    }
                }
            }
            world.run_for(millis(900));
            second += 1;
        }
        longest = longest.max(second - begin);
        waiting.end(&mut world).unwrap();
        for client in &mut trickling {
            if client.read(&mut world, 0, 9).is_err() {
                client.open(&mut world, "log.bin").unwrap();
            }
        }
    }
    println!("30 of 30 opens, each after at most {longest} s");
}

/// a peer that had several files open and used them kept all others out for ever. Now one that has none gets the place of the
/// file that was idle for the longest, at once. Of peers with one each, none gives way.
#[test]
fn peer_with_several_files_gives_one_up() {
    let mut world = slow_world();
    let mut several = [Client::new(STATION, 0, 0), Client::new(STATION, 0, 1)];
    for client in &mut several {
        client.open(&mut world, "log.bin").unwrap();
    }
    for _ in 0..40 {
        for client in &mut several {
            client.read(&mut world, 0, 239).unwrap();
        }
    }
    let mut waiting = WAITING;
    assert_eq!(waiting.open(&mut world, "log.bin"), Ok(100_000));
    assert_eq!(several[0].read(&mut world, 0, 9), Err(MavFtpErr::INVALIDSESSION), "read before the other one");
    assert!(several[1].read(&mut world, 0, 9).is_ok());
    assert_eq!(several[0].open(&mut world, "log.bin"), Err(MavFtpErr::NOSESSIONSAVAILABLE), "it has one");
    let mut third = Client::new(Address::new(77, 1), 1, 5);
    assert_eq!(third.open(&mut world, "log.bin"), Err(MavFtpErr::NOSESSIONSAVAILABLE), "the others have one each");
}

/// a client that reads more than a twentieth of the link's rate keeps its session for a turn of 30 s, though others wait: here packet
/// by packet, half a second apart. It kept it for as long as it liked, and the waiting one got nothing. Now each of the three reads two
/// thirds of the time, if it opens the file again.
#[test]
fn used_sessions_take_turns() {
    let mut world = slow_world();
    let [first, second] = holders(&mut world);
    let (mut clients, mut read) = ([first, second, WAITING], [0; 3]);
    for round in 0..240 {
        for (client, read) in clients.iter_mut().zip(&mut read) {
            if client.read(&mut world, 0, 239).is_ok() || client.open(&mut world, "log.bin").is_ok() {
                *read += 1;
            }
        }
        assert!(round > 50 || read[2] == 0, "round {round}: {read:?}");
        world.run_for(millis(300));
    }
    println!("of 240 rounds: {read:?}");
    assert!(read.iter().all(|read| *read > 100), "{read:?}");
}

/// two clients with a burst every four seconds, or that open their file again every two seconds, with or without an end, kept the
/// sessions for ever: 0 of 120 and 0 of 60 opens of others. Now a client waits for 30 s at most.
#[test]
fn bursts_and_new_opens_keep_no_session() {
    for (way, period) in [("bursts", 4), ("opens", 2), ("ends", 2)] {
        let mut world = slow_world();
        let mut waiting = WAITING;
        let mut clients = holders(&mut world);
        let (mut opened, mut waited) = (0, 0);
        for second in 0..120 {
            for client in clients.iter_mut().filter(|_| second % period == 0) {
                if way == "ends" {
                    client.seq += 1;
                    client.send(&mut world, &request(client.seq, 0, Op::TERMINATESESSION, 0, 0, &[]));
                }
                let (opcode, path) = (Op::OPENFILERO, b"log.bin");
                let mut ask = |world: &mut Shelf, opcode, data: &[u8], size| {
                    client.seq += 100;
                    client.send(world, &request(client.seq, client.session, opcode, size, 0, data));
                };
                ask(&mut world, opcode, path, 7);
                if way == "bursts" && second % 28 > 0 {
                    ask(&mut world, Op::BURSTREADFILE, &[], 239);
                }
            }
            world.run_for(millis(500));
            if waiting.open(&mut world, "log.bin").is_ok() {
                (opened, waited) = (opened + 1, 0);
                waiting.end(&mut world).unwrap();
            } else {
                waited += 1;
                assert!(waited <= 35, "{way}: {second} s");
            }
            world.run_for(millis(400));
        }
        println!("{way}: {opened} of 120");
    }
}

/// two clients that asked for the checksum of a large file again and again left 0 of 60 to others. Now they take turns: whoever has
/// waited for longest is next.
#[test]
fn checksums_take_turns() {
    let mut world = slow_world();
    world.vehicle.files.content.insert("large.bin".to_string(), pattern(200_000));
    let (mut clients, mut waiting) = (HOLDERS, WAITING);
    let mut answered = 0;
    for round in 0..600 {
        for client in &mut clients {
            client.seq += 1;
            client.send(&mut world, &request(client.seq, client.session, Op::CALCFILECRC, 9, 0, b"large.bin"));
        }
        if round % 5 == 0 {
            waiting.seq += 1;
            waiting.send(&mut world, &request(waiting.seq, waiting.session, Op::CALCFILECRC, 9, 0, b"large.bin"));
        }
        for _ in 0..4 {
            answered += waiting.packets(&mut world).iter().filter(|packet| packet.error().is_none()).count();
        }
    }
    println!("{answered} checksums");
    assert!(answered >= 6, "{answered}");
}

/// a session that was well used is judged by what followed: a client that has read fast for a minute gives way after ten seconds of
/// trickling, not after as long as its average is good.
#[test]
fn past_use_keeps_no_session() {
    let mut world = slow_world();
    let (mut holders, mut waiting) = (holders(&mut world), WAITING);
    for _ in 0..200 {
        for holder in &mut holders {
            holder.read(&mut world, 0, 239).unwrap();
        }
    }
    let opened = (0..15).find(|_| {
        for holder in &mut holders {
            holder.read(&mut world, 0, 9).unwrap();
        }
        let is_open = waiting.open(&mut world, "log.bin").is_ok();
        world.run_for(millis(850));
        is_open
    });
    assert!(opened.is_some_and(|second| second <= 11), "{opened:?}");
}

/// nobody waits for a slow honest client, so it goes on: beside another one, for as long as it likes.
#[test]
fn slow_files_alone_go_on() {
    let mut world = slow_world();
    let mut holders = holders(&mut world);
    for _ in 0..60 {
        for holder in &mut holders {
            assert!(holder.read(&mut world, 0, 9).is_ok());
        }
        world.run_for(millis(1_900));
    }
    holders[0].end(&mut world).unwrap();
    assert_eq!({ WAITING }.open(&mut world, "log.bin"), Ok(100_000), "there is a free session");
    assert!(holders[1].read(&mut world, 0, 9).is_ok());
}

/// an upload of one byte every two seconds refused all other uploads for ever (0 of 30). Now another client's begins within 12 s,
/// and the first one learns that its upload has ended.
#[test]
fn trickle_keeps_no_upload() {
    let mut world = slow_world();
    let ([mut slow, _], mut waiting) = (HOLDERS, WAITING);
    slow.create(&mut world, "@MISSION/mission.dat").unwrap();
    // The header of a mission of five items, and part of the first one.
    let mut bytes = [0; 30];
    (bytes[0], bytes[1], bytes[8]) = (0x3D, 0x76, 5);
    let mut sent = 0;
    let begun = (0..30).find(|second| {
        if second % 2 == 0 {
            slow.write(&mut world, sent as u32, &bytes[sent..=sent]).unwrap();
            sent += 1;
        }
        let is_open = waiting.create(&mut world, "@MISSION/mission.dat").is_ok();
        world.run_for(millis(900));
        is_open
    });
    assert!(begun.is_some_and(|second| second <= 12), "{begun:?}");
    assert!(slow.write(&mut world, sent as u32, &[0]).is_err());
}

/// a part of a plan's file every two seconds refused uploads by messages for ever, and an item in 4.8 s those of files. Each gives
/// way to the other after 15 s: 0 of 12 and 0 of 20 were accepted before.
#[test]
fn slow_plans_by_files_and_messages() {
    let whole = file(PlanType::Mission, &items(PlanType::Mission, 40, 1));
    let mut world = slow_world();
    let [mut slow, _] = HOLDERS;
    slow.create(&mut world, "@MISSION/mission.dat").unwrap();
    let accepted = (0..12).find(|number| {
        slow.write(&mut world, number * 20, &whole[*number as usize * 20..][..20]).unwrap();
        world.run_for(secs(2));
        world.upload(1, &items(PlanType::Fence, 2, 1)).is_ok()
    });
    assert_eq!(accepted, Some(7), "after 16 s");
    assert_eq!(slow.write(&mut world, 160, &whole[160..180]), Err(MavFtpErr::FAIL));
    assert_eq!(slow.end(&mut world), Ok(vec![]), "it knows");
    world.upload(1, &items(PlanType::Mission, 3, 1)).expect("the staging area is free");

    let mut waiting = WAITING;
    let count = MissionCount { count: 50, target_system: 1, target_component: 1, ..MissionCount::default() };
    world.gcs[0].send(&count);
    world.run_for(millis(100));
    let accepted = (0..20).find(|second| {
        if second % 4 == 0 {
            let of_us = MissionItemInt { target_system: 1, target_component: 1, ..items(PlanType::Mission, 1, 1)[0] };
            let item = MissionItemInt { seq: second / 4, ..of_us };
            world.gcs[0].send(&item);
        }
        world.run_for(secs(1));
        waiting.create(&mut world, "@MISSION/mission.dat").is_ok()
    });
    assert!(accepted.is_some_and(|second| (14..=16).contains(&second)), "{accepted:?}");
}

/// the one in control takes what it needs at once: before, its open was refused while the two were busy (0 of 20).
#[test]
fn operator_in_control_gets_a_session_at_once() {
    let mut field = Field::new();
    let others = [STATION, Address::new(200, 1)];
    for from in others {
        assert_eq!(field.ask(from, Op::OPENFILERO, b"log.bin"), Some(Ok(())));
    }
    field.take_control(OTHER_STATION);
    for from in others {
        assert_eq!(field.ask(from, Op::READFILE, b""), Some(Ok(())));
    }
    let begin = field.world.now();
    assert_eq!(field.ask(OTHER_STATION, Op::OPENFILERO, b"log.bin"), Some(Ok(())));
    assert!(field.world.now() - begin <= secs(1));
    let has_lost = others.map(|from| field.ask(from, Op::READFILE, b"") == Some(Err(MavFtpErr::INVALIDSESSION)));
    assert_eq!(has_lost, [true, false], "the one that was idle for longer");
    let refused = field.ask(STATION, Op::OPENFILERO, b"log.bin");
    assert_eq!(refused, Some(Err(MavFtpErr::NOSESSIONSAVAILABLE)), "it does not take it back");
}

/// five clients on a link of 1,200 baud each list the directory once a second. Their answers wait for the link, and kept all
/// sessions: 1 of 60 requests on the other link was answered.
#[test]
fn slow_link_keeps_no_sessions() {
    let bauds = [1_200, 57_600];
    let links = bauds.map(|baud| LinkConfig::uart(baud).with_streams(StreamProfile::Off));
    let lines = bauds.map(|baud| {
        let down = Wire { bytes_per_second: u64::from(baud / 10), tx_fifo: 128, ..Wire::default() };
        LineConfig { down, ..LineConfig::default() }
    });
    let mut world = Shelf::of(Setup { links, lines, step: millis(5), ..Setup::new() });
    world.vehicle.files.content.insert("log.bin".to_string(), pattern(1_000));
    world.run_for(millis(10));
    let mut crowd = [200, 201, 202, 203, 204].map(|system| Client::new(Address::new(system, 1), 0, 0));
    let mut waiting = WAITING;
    for _ in 0..60 {
        for client in &mut crowd {
            client.seq += 1;
            client.send(&mut world, &request(client.seq, 0, Op::LISTDIRECTORY, 1, 0, b"/"));
        }
        world.run_for(millis(900));
        assert_eq!(waiting.open(&mut world, "log.bin"), Ok(1_000));
        waiting.end(&mut world).unwrap();
    }
}
