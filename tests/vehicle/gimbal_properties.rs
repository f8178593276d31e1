//! The gimbal manager against a simple reference model: whatever is sent, by anyone at any time, a setpoint of one that is not in
//! control never reaches the vehicle (GIM-4), and no number that is not finite does (GIM-5).

use super::gimbal::{Carried, send, world};
use crate::support::*;
use mavstack::Address;
use mavstack::dialect::*;
use mavstack::gimbal::{Axes, GimbalTarget};
use proptest::prelude::*;

/// Two stations, another component of the first, a companion, and frames from nobody.
const SENDERS: [Address; 5] = [STATION, OTHER_STATION, Address::new(255, 25), Address::new(1, 191), Address::new(0, 0)];

#[derive(Clone, Debug)]
enum Action {
    /// MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE.
    Configure([i16; 4]),
    /// A command that points, by its place in [`COMMANDS`].
    Command(usize, [f32; 7]),
    Attitude([f32; 4], [f32; 3], u32),
    PitchYaw([f32; 4], u32),
    Manual([f32; 4], u32),
    /// The vehicle releases what it has.
    Release,
}

const COMMANDS: [MavCmd; 8] = [
    MavCmd::DO_GIMBAL_MANAGER_PITCHYAW,
    MavCmd::DO_SET_ROI_LOCATION,
    MavCmd::DO_SET_ROI_WPNEXT_OFFSET,
    MavCmd::DO_SET_ROI_NONE,
    MavCmd::DO_SET_ROI_SYSID,
    MavCmd::DO_SET_ROI,
    MavCmd::DO_MOUNT_CONTROL,
    MavCmd::DO_MOUNT_CONFIGURE,
];

fn number() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => prop::sample::select(&[0.0, 1.0, -1.0, 2.0, 3.0, 4.0, 7.0, 47.0, 90.0, 154.0][..]),
        2 => Just(f32::NAN),
        1 => any::<f32>(),
        1 => Just(f32::INFINITY),
    ]
}

fn action() -> impl Strategy<Value = (usize, Action)> {
    let pair = prop_oneof![
        3 => prop::sample::select(&SENDERS[..]).prop_map(|it| [i16::from(it.system.wire()), i16::from(it.component.wire())]),
        2 => prop::sample::select(&[[-1, -1], [-2, -2], [-3, -3], [0, 0]][..]),
        1 => any::<[i8; 2]>().prop_map(|pair| pair.map(i16::from)),
    ];
    let configure = [pair.clone(), pair].prop_map(|[[a, b], [c, d]]| Action::Configure([a, b, c, d]));
    let four = || prop::array::uniform4(number());
    let unit = prop_oneof![2 => Just([1.0, 0.0, 0.0, 0.0]), 1 => four()];
    let flags = || prop_oneof![4 => Just(12u32), 1 => any::<u32>()];
    let what = prop_oneof![
        3 => configure,
        4 => (0..COMMANDS.len(), prop::array::uniform7(number())).prop_map(|(id, params)| Action::Command(id, params)),
        2 => (unit, prop::array::uniform3(number()), flags()).prop_map(|(q, rates, flags)| Action::Attitude(q, rates, flags)),
        2 => (four(), flags()).prop_map(|(angles, flags)| Action::PitchYaw(angles, flags)),
        2 => (four(), flags()).prop_map(|(sticks, flags)| Action::Manual(sticks, flags)),
        1 => Just(Action::Release),
    ];
    (0..SENDERS.len(), what)
}

fn on(world: &mut Carried, from: Address, action: &Action) {
    let (target_system, target_component) = (1, 1);
    match *action {
        Action::Configure(params) => {
            let [a, b, c, d] = params.map(f32::from);
            let message = world.gcs[0].long(MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, [a, b, c, d, 0.0, 0.0, 0.0]);
            send(world, 0, from, &message);
        }
        Action::Command(id, params) => {
            let message = world.gcs[0].long(COMMANDS[id], params);
            send(world, 0, from, &message);
        }
        Action::Attitude(q, [x, y, z], flags) => {
            let message = GimbalManagerSetAttitude {
                q,
                angular_velocity_x: x,
                angular_velocity_y: y,
                angular_velocity_z: z,
                flags: GimbalManagerFlags(flags),
                target_system,
                target_component,
                gimbal_device_id: 0,
            };
            send(world, 1, from, &message);
        }
        Action::PitchYaw([pitch, yaw, pitch_rate, yaw_rate], flags) => {
            let flags = GimbalManagerFlags(flags);
            let message = GimbalManagerSetPitchyaw {
                pitch,
                yaw,
                pitch_rate,
                yaw_rate,
                flags,
                target_system,
                target_component,
                gimbal_device_id: 1,
            };
            send(world, 1, from, &message);
        }
        Action::Manual([pitch, yaw, pitch_rate, yaw_rate], flags) => {
            let flags = GimbalManagerFlags(flags);
            let message = GimbalManagerSetManualControl {
                pitch,
                yaw,
                pitch_rate,
                yaw_rate,
                flags,
                target_system,
                target_component,
                gimbal_device_id: 0,
            };
            send(world, 1, from, &message);
        }
        Action::Release => {
            let own = world.stack.address();
            world.stack.gimbal_manager.release(own);
        }
    }
}

/// The reference model of who is in control.
#[derive(Debug, Default)]
struct Model {
    primary: Option<Address>,
    secondary: Option<Address>,
}

impl Model {
    fn configured([system, component]: [i16; 2], has: Option<Address>, from: Address) -> Result<Option<Address>, ()> {
        match (system, component) {
            (-1, -1) => Ok(has),
            (-2, -2) => Ok(Some(from).filter(|from| from.system.wire() != 0)),
            (-3, -3) => Ok(has.filter(|has| *has != from)),
            (0, 0..) => Ok(None),
            (1.., 1..) => Ok(Some(Address::new(system as u8, component as u8))),
            _ => Err(()),
        }
    }

    fn may(&self, from: Address) -> bool {
        from.system.wire() != 0 && [self.primary, self.secondary].contains(&Some(from))
    }
}

fn is_finite(target: GimbalTarget) -> bool {
    let all = |numbers: &[Option<f32>], limit: f32| numbers.iter().flatten().all(|number| number.abs() <= limit);
    let axes = |axes: Axes, limit: f32| all(&[axes.roll(), axes.pitch(), axes.yaw()], limit);
    match target {
        GimbalTarget::Angles { angles, rates } => axes(angles, f32::MAX) && axes(rates, f32::MAX),
        GimbalTarget::Attitude { q, rates } => q.iter().all(|number| number.is_finite()) && axes(rates, f32::MAX),
        GimbalTarget::Manual { angles, rates } => axes(angles, 1.0) && axes(rates, 1.0),
        GimbalTarget::Location { position, altitude, .. } => {
            let is_on_globe = position.latitude.abs() <= 900_000_000 && position.longitude.abs() <= 1_800_000_000;
            is_on_globe && all(&[altitude], f32::MAX)
        }
        GimbalTarget::NextWaypoint { offsets } => axes(offsets, f32::MAX),
        GimbalTarget::System(system) => system.wire() != 0,
        _ => true,
    }
}

fn run(actions: &[(usize, Action)]) -> Result<(), TestCaseError> {
    let mut world = world();
    let mut model = Model::default();
    for (sender, action) in actions {
        let from = SENDERS[*sender];
        let before = world.vehicle.pointed.len();
        on(&mut world, from, action);
        let is_pointed = world.vehicle.pointed.len() > before;
        match action {
            // Nobody sends nothing.
            Action::Configure(_) if from.system.wire() == 0 => {}
            Action::Configure([a, b, c, d]) => {
                let pairs = (
                    Model::configured([*a, *b], model.primary, from),
                    Model::configured([*c, *d], model.secondary, from),
                );
                if let (Ok(primary), Ok(secondary)) = pairs {
                    (model.primary, model.secondary) = (primary, secondary);
                }
                prop_assert!(!is_pointed);
            }
            Action::Release => {
                model.primary = model.primary.filter(|primary| *primary != VEHICLE);
                model.secondary = model.secondary.filter(|secondary| *secondary != VEHICLE);
            }
            Action::Command(id, params) => {
                let is_free = model.primary.is_none() && *id > 0 && from.system.wire() != 0;
                prop_assert!(!is_pointed || is_free || model.may(from), "{model:?} {from:?}");
                // A mode that only takes control.
                let only_takes = *id == 7 && [2.0, 4.0].contains(&params[0]);
                if is_free && (is_pointed || only_takes) {
                    model.primary = Some(from);
                }
            }
            _ => prop_assert!(!is_pointed || model.may(from), "{model:?} {from:?}"),
        }
        if let Some(setpoint) = world.vehicle.pointed.last().filter(|_| is_pointed) {
            prop_assert_eq!(setpoint.from, from);
            prop_assert_eq!(setpoint.is_secondary, model.primary != Some(from));
            prop_assert!(is_finite(setpoint.target), "{setpoint:?}");
        }
        let control = world.stack.gimbal_manager.control();
        prop_assert_eq!((control.primary, control.secondary), (model.primary, model.secondary));
        // So that there is room for the next answer.
        world.run_for(millis(2));
    }
    Ok(())
}

proptest! {
    #![proptest_config(cases(200))]

    /// GIM-4, GIM-5.
    #[test]
    fn who_is_not_in_control_never_points(actions in prop::collection::vec(action(), 1..60)) {
        run(&actions)?;
    }
}
