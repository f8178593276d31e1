//! Answers of hooks that promise an end that nobody keeps: rules C-20, C-22.

use crate::support::*;
use mavstack::__private::Declares;
use mavstack::dialect::*;
use mavstack::message::ComponentId;
use mavstack::{
    Address, Command, CommandClient, CommandReply, Commands, Component, Components, Context, Outcome, OutgoingCommand,
    Vehicle, VehicleState,
};

const CALIBRATE: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
const WINCH: ComponentId = ComponentId::new(158);

#[derive(mavstack::Stack)]
#[stack(vehicle: Hasty, links: 1)]
struct NoSlots;
#[derive(mavstack::Stack)]
#[stack(vehicle: Hasty, links: 1, commands: { slots: 1 })]
struct OneSlot;
#[derive(mavstack::Stack)]
#[stack(vehicle: Hasty, links: 1, components, command_client: { slots: 1 })]
struct Parts;

/// Answers every command IN_PROGRESS, without [`Context::start`].
#[derive(Default)]
struct Hasty {
    replies: Vec<CommandReply>,
}

impl Vehicle for Hasty {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Hasty {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::IN_PROGRESS.into()
    }
}

impl Components for Hasty {
    const COMPONENTS: &'static [Component] = &[Component::new(WINCH, MavType::WINCH)];

    fn component_command(&mut self, _: &mut Context<'_>, _: ComponentId, _: &Command) -> Outcome {
        MavResult::IN_PROGRESS.into()
    }
}

impl CommandClient for Hasty {
    fn command_for(&mut self, _: u16) -> Option<OutgoingCommand> {
        Some(OutgoingCommand::long(MavCmd::DO_WINCH, [1.0; 7]))
    }

    fn command_answered(&mut self, _: &mut Context<'_>, _: u16, reply: CommandReply) {
        self.replies.push(reply);
    }
}

fn texts<D: Declares<Vehicle = Hasty>>(world: &mut World<1, D>) -> Vec<String> {
    let gcs = &mut world.gcs[0];
    let texts = std::iter::from_fn(|| gcs.take::<Statustext>());
    texts.map(|(_, text)| text.text.as_str().unwrap().to_owned()).collect()
}

/// Sends a command to a component. Returns the results that come within ten seconds.
fn results<D: Declares<Vehicle = Hasty>>(world: &mut World<1, D>, component: u8, command: MavCmd) -> Vec<MavResult> {
    let message = CommandLong { target_component: component, ..world.gcs[0].long(command, [1.0; 7]) };
    world.gcs[0].send(&message);
    world.run_for(secs(10));
    let gcs = &mut world.gcs[0];
    std::iter::from_fn(|| gcs.take::<CommandAck>()).map(|(_, ack)| ack.result).collect()
}

/// C-20: without slots, IN_PROGRESS is a promise that nothing ends: it is answered FAILED, counted, and explained by a text.
#[test]
fn in_progress_without_slots_fails() {
    let mut world = World::<1, NoSlots>::of(Setup::new());
    assert_eq!(results(&mut world, 1, CALIBRATE), [MavResult::FAILED]);
    assert_eq!(texts(&mut world), ["IN_PROGRESS without a slot"]);
    assert_eq!(world.stack.hook_faults().unfinished, 1);
}

/// C-20, C-22: with a slot, IN_PROGRESS is kept. Without a free one it fails.
#[test]
fn in_progress_without_a_free_slot_fails() {
    let mut world = World::<1, OneSlot>::of(Setup::new());
    let running = results(&mut world, 1, CALIBRATE);
    assert!(running.len() > 5 && running.iter().all(|result| *result == MavResult::IN_PROGRESS), "{running:?}");
    assert_eq!(world.stack.hook_faults().unfinished, 0);
    world.gcs[0].forget();
    let both = results(&mut world, 1, MavCmd::DO_MOTOR_TEST);
    assert_eq!(both.iter().filter(|result| **result == MavResult::FAILED).count(), 1);
    assert_eq!(texts(&mut world), ["IN_PROGRESS without a slot"]);
    assert_eq!(world.stack.hook_faults().unfinished, 1);
    // The first one still ends.
    assert!(world.stack.long_commands_mut().finish(CALIBRATE, MavResult::ACCEPTED));
    world.gcs[0].forget();
    world.run_for(secs(1));
    assert_eq!(world.expect::<CommandAck>(0, millis(10)).result, MavResult::ACCEPTED);
}

/// C-20: the same for another component of the firmware, also when the firmware itself sends the command.
#[test]
fn in_progress_of_a_component_without_slots_fails() {
    let mut world = World::<1, Parts>::of(Setup::new());
    assert_eq!(results(&mut world, WINCH.wire(), MavCmd::DO_WINCH), [MavResult::FAILED]);
    assert_eq!(texts(&mut world), ["IN_PROGRESS without a slot"]);
    let now = world.now();
    assert!(world.stack.with_context(now, |cx| cx.send_command(Address::new(1, WINCH.wire()), 1)));
    world.run_for(secs(1));
    assert_eq!(world.vehicle.replies, [CommandReply::Done { result: MavResult::FAILED, result_param2: 0 }]);
    assert_eq!(world.stack.hook_faults().unfinished, 2);
}
