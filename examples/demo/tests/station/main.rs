//! The demo vehicle in the rig of `mavstack-station`, as its ground stations see it.

use mavstack::dialect::{HighLatency2, MavCmd};
use mavstack::storage::Store;
use mavstack::{Duration, Instant, LinkId, StackOf};
use mavstack_demo::{App, LogMemory, Mavlink, Mode, Quadrotor, Tuning};
use mavstack_station::command::Place;
use mavstack_station::kit::{self, Board, Firmware, LineConfig, Port, RamFlash, Rig};
use mavstack_station::parameters::Value;
use mavstack_station::plans::waypoint;
use mavstack_station::sticks::{Input, Sticks};
use mavstack_station::{Client, Failure, GroundStation};

const SECOND: Duration = Duration::from_secs(1);

type Flash = RamFlash<4, 4_096>;

/// The demo as the rig runs it.
struct Demo {
    app: App<Box<StackOf<Mavlink>>>,
    store: Store<Flash>,
}

impl Demo {
    fn boot(board: &Board, logs: &'static LogMemory) -> Self {
        let len = Store::<Flash>::region_len::<Mavlink>();
        let mut store = Store::new(board.flash(len), 0..len);
        let mut app = App::in_fleet(Box::new(StackOf::<Mavlink>::VACANT), kit::pulse(), 1);
        app.keep_logs(logs);
        app.restore(Instant::ZERO, &mut store).expect("what is stored can be read");
        Self { app, store }
    }

    fn vehicle(&self) -> &Quadrotor {
        self.app.vehicle()
    }
}

impl Firmware for Demo {
    fn fly(&mut self, now: Instant) {
        self.app.fly(now);
    }

    fn poll(&mut self, now: Instant, ports: &mut [Port]) {
        self.app.poll(now);
        for (link, port) in (0..).map(LinkId).zip(ports) {
            self.app.serve(now, link, port).expect("the line has no faults");
        }
        self.app.persist(now, &mut self.store);
    }

    fn wants_reboot(&self) -> bool {
        self.app.wants_reboot()
    }
}

/// Returns a vehicle with a GPS fix, and a station that is connected by a radio.
fn rig(client: Client) -> Rig<Demo> {
    // Logs are in memory that a reset keeps.
    let logs: &'static LogMemory = Box::leak(Box::new(LogMemory::new()));
    let radio = LineConfig::radio(115_200, Duration::from_millis(20));
    let mut rig = Rig::new(move |board| Demo::boot(board, logs)).with_line(radio, client);
    rig.connect().expect("a vehicle");
    rig.until(SECOND * 5, |rig| rig.firmware().vehicle().has_fix());
    rig
}

/// Returns a vehicle that hovers at 10 m.
fn in_the_air(client: Client) -> Rig<Demo> {
    let mut rig = rig(client);
    rig.arm().expect("it is ready");
    rig.takeoff(10.0).expect("it is armed");
    rig.until(SECOND * 20, |rig| rig.firmware().vehicle().mode() == Mode::Hold);
    rig
}

/// The simplest flight, as each client flies it.
#[test]
fn takes_off_and_lands() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = in_the_air(client);
        rig.command(MavCmd::NAV_LAND, &[])?;
        rig.until(SECOND * 60, |rig| rig.seen().has_text("Landed, disarmed"));
    }
    Ok(())
}

#[test]
fn parameters_are_listed_set_and_read() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client);
        let all = rig.parameters()?;
        assert!(all.iter().any(|parameter| parameter.name == "MPC_XY_CRUISE"), "{all:?}");
        assert_eq!(rig.set("MPC_XY_CRUISE", 5.0_f32)?, Value::F32(5.0));
        assert_eq!(rig.get("MPC_XY_CRUISE")?, Value::F32(5.0));
    }
    Ok(())
}

/// Each refusal has a reason, which the pilot reads.
#[test]
fn refusals_have_reasons() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl);
    let failure = rig.set("MPC_XY_CRUISE", 99.0_f32).unwrap_err();
    assert_eq!(failure.text(), Some("MPC_XY_CRUISE: out of range"));
    let failure = rig.command(MavCmd::MISSION_START, &[]).unwrap_err();
    assert_eq!(failure.text(), Some("Command 300 refused: there is no such item"));
    let failure = rig.takeoff(10.0).unwrap_err();
    assert_eq!(failure.text(), Some("Command refused: not armed"));
    Ok(())
}

/// A vehicle must not seem alive when nothing flies it.
#[test]
fn a_hung_flight_loop_ends_the_heartbeats() {
    let mut rig = rig(Client::QGroundControl);
    rig.hang_flight_loop();
    rig.run_for(SECOND * 5);
    assert!(rig.now() - rig.seen().vehicles().next().unwrap().last_heartbeat() > SECOND * 3);
}

#[test]
fn flies_a_mission_that_comes_down_again() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl);
    let mission = [47.397_9, 47.397_8].map(|latitude| waypoint(Place::relative(latitude, 8.545_6, 10.0)));
    rig.upload_mission(&mission)?;
    assert_eq!(rig.download_mission()?, mission);
    rig.arm()?;
    rig.set_mode(Mode::Mission.number())?;
    rig.until(SECOND * 60, |rig| rig.seen().has_text("Mission complete"));
    Ok(())
}

#[test]
fn modes_are_listed_and_selected() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = in_the_air(client);
        assert!(rig.modes()?.iter().any(|mode| mode.name == "Return"));
        rig.set_mode(Mode::Return.number())?;
        rig.set_mode(Mode::Hold.number())?;
    }
    Ok(())
}

#[test]
fn holds_when_the_sticks_are_lost() -> Result<(), Failure> {
    let mut rig = in_the_air(Client::QGroundControl);
    let mut pilot = rig.alongside(Sticks::new(Input::joystick(0.5, 0.0, 0.5, 0.0)));
    pilot.wait(SECOND)?;
    pilot.set_mode(Mode::Position.number())?;
    pilot.wait(SECOND * 2)?;
    assert!(rig.firmware().vehicle().velocity().north > 1.0);
    rig.until(SECOND * 2, |rig| rig.firmware().vehicle().mode() == Mode::Hold);
    Ok(())
}

/// A vehicle out of the station's reach reports by satellite.
#[test]
fn reports_by_satellite_when_the_station_is_lost() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl)
        .with_line(LineConfig::uart(921_600), Client::Pymavlink)
        .with_line(LineConfig::uart(2_400), Client::Pymavlink);
    rig.set("MAV_HL_LOSS_T", 10)?;
    rig.run_for(SECOND * 60);
    assert_eq!(rig.on(2).seen().count::<HighLatency2>(), 0);
    rig.line(0).cut();
    rig.run_for(SECOND * 20);
    assert_eq!(rig.on(2).seen().count::<HighLatency2>(), 1);
    Ok(())
}

/// A log of a flight is downloaded over a radio that loses frames.
#[test]
fn logs_are_downloaded() -> Result<(), Failure> {
    for client in [Client::QGroundControl, Client::Mavsdk, Client::MavProxy] {
        let mut rig = rig(client);
        rig.arm()?;
        rig.run_for(SECOND * 2);
        rig.disarm()?;
        let logs = rig.list_logs()?;
        rig.line(0).set_loss(0.05);
        let content = rig.read_log(logs[0])?;
        assert!(content.starts_with(b"ULog") && content.len() == logs[0].size as usize, "{client}");
    }
    Ok(())
}

/// C-30, P-17: parameters set right before a reboot are written before it, without the usual delay.
#[test]
fn a_reboot_restores_the_parameters() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl);
    for (reboots, speed) in (1..).zip([5.0, 6.0, 7.0]) {
        rig.set("MPC_XY_CRUISE", speed)?;
        rig.command(MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0])?;
        rig.until(Duration::from_millis(500), |rig| rig.reboots() == reboots);
        assert_eq!(rig.firmware().app.stack().parameters().get(Tuning::MPC_XY_CRUISE), speed);
        assert_eq!(rig.get("MPC_XY_CRUISE")?, Value::F32(speed));
    }
    Ok(())
}
