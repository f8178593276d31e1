//! Parameters.

use crate::vehicle::{persist, rig};
use mavstack::dialect::MavParamError;
use mavstack_station::parameters::{Set, Value};
use mavstack_station::{Client, Drive, Failure, GroundStation};

/// The clients that decode integers of a generic autopilot bytewise.
const BYTEWISE: [Client; 2] = [Client::QGroundControl, Client::Mavsdk];

#[test]
fn every_client_downloads_the_list() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let parameters = rig.parameters()?;
        assert_eq!(parameters.len(), 22, "{client}");
        assert_eq!(parameters[4].name, "CRUISE");
        assert_eq!(parameters[4].value, Value::F32(5.0));
        let trim = if BYTEWISE.contains(&client) { Value::I16(-300) } else { parameters[21].value };
        assert_eq!(parameters[21].value, trim, "{client}");
    }
    Ok(())
}

#[test]
fn the_list_gets_through_a_line_that_loses_a_fifth() {
    for client in Client::ALL {
        for seed in 0..20 {
            let mut rig = rig(client, 0.2, seed);
            persist(&mut rig, 5, |rig| rig.connect());
            let parameters = persist(&mut rig, 4, |rig| rig.parameters());
            let names: Vec<_> = parameters.iter().map(|parameter| &parameter.name).collect();
            assert!(names.len() == 22 && names.is_sorted(), "{client}, seed {seed}: {names:?}");
        }
    }
}

#[test]
fn a_set_is_confirmed() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        assert_eq!(rig.set("CRUISE", 7.5)?, Value::F32(7.5), "{client}");
        assert_eq!(rig.get("CRUISE")?, Value::F32(7.5), "{client}");
    }
    Ok(())
}

/// The number is sent with the type that the vehicle's parameter has.
#[test]
fn an_integer_is_set_bytewise() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl, 0.0, 1);
    rig.connect()?;
    assert_eq!(rig.set("FENCE_ACT", 3)?, Value::I32(3));
    assert_eq!(rig.set("FENCE_ACT", 2.0)?, Value::I32(2));
    assert_eq!(rig.set("TRIM", -77)?, Value::I16(-77));
    let failure = rig.set("FENCE_ACT", 0.5).expect_err("it is an integer");
    assert!(matches!(failure, Failure::Protocol(_)), "{failure}");
    Ok(())
}

/// MAVSDK looks up the type for an integer, and is strict.
#[test]
fn mavsdk_sets_integers_and_floats_by_different_calls() -> Result<(), Failure> {
    let mut rig = rig(Client::Mavsdk, 0.0, 1);
    rig.connect()?;
    assert_eq!(rig.set("FENCE_ACT", 3)?, Value::I32(3));
    let failure = rig.set("CRUISE", 7).expect_err("it is a float");
    assert!(matches!(failure, Failure::Param { error: Some(MavParamError::TYPE_MISMATCH), .. }), "{failure}");
    let failure = rig.set("FENCE_ACT", 2.0).expect_err("it is an integer");
    assert!(matches!(failure, Failure::Param { error: Some(MavParamError::TYPE_MISMATCH), .. }), "{failure}");
    Ok(())
}

/// MAVProxy decodes integers of a generic autopilot as floats: it shows 1 as 1.4e-45, and does not see that 3 was set.
#[test]
fn mavproxy_does_not_understand_integers() -> Result<(), Failure> {
    let mut rig = rig(Client::MavProxy, 0.0, 1);
    rig.connect()?;
    assert_eq!(rig.get("FENCE_ACT")?, Value::F32(f32::from_bits(1)));
    let failure = rig.set("FENCE_ACT", 3).expect_err("MAVProxy sees another value");
    assert!(matches!(failure, Failure::Param { error: None, .. }), "{failure}");
    assert_eq!(rig.firmware().stack.parameters().get(crate::vehicle::Tuning::FENCE_ACT), 3);
    Ok(())
}

#[test]
fn a_refusal_has_its_reason() -> Result<(), Failure> {
    for client in BYTEWISE {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let error_of = |result: Result<Value, Failure>| match result {
            Err(Failure::Param { error, .. }) => error,
            other => panic!("{client}: {other:?}"),
        };
        assert_eq!(error_of(rig.set("CRUISE", 50.0)), Some(MavParamError::VALUE_OUT_OF_RANGE), "{client}");
        assert_eq!(error_of(rig.get("NOTHING")), Some(MavParamError::DOES_NOT_EXIST), "{client}");
    }
    // MAVSDK sends NaN for every integer but INT32.
    let mut rig = rig(Client::Mavsdk, 0.0, 1);
    rig.connect()?;
    let failure = rig.set("SYS_ID", 2).expect_err("MAVSDK cannot encode it");
    assert!(matches!(failure, Failure::Param { error: Some(_), .. }), "{failure}");
    assert!(failure.text().is_some(), "{failure}");
    Ok(())
}

/// Clients that ignore PARAM_ERROR see that the value stayed; a script that takes any answer does not.
#[test]
fn clients_that_ignore_param_error_see_the_old_value() -> Result<(), Failure> {
    let mut proxy = rig(Client::MavProxy, 0.0, 1);
    proxy.connect()?;
    let begin = proxy.now();
    let failure = proxy.set("CRUISE", 50.0).expect_err("out of range");
    assert!(matches!(failure, Failure::Param { error: Some(MavParamError::VALUE_OUT_OF_RANGE), .. }), "{failure}");
    assert!((proxy.now() - begin).as_millis() >= 3_000, "it is tried three times");
    let mut script = rig(Client::Pymavlink, 0.0, 1);
    script.connect()?;
    assert_eq!(script.set("CRUISE", 50.0)?, Value::F32(5.0));
    Ok(())
}

#[test]
fn a_wrong_type_can_be_sent() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl, 0.0, 1);
    rig.connect()?;
    let failure = rig.run(Set::typed("CRUISE", Value::I32(1_000_000))).expect_err("it is a REAL32");
    assert!(matches!(failure, Failure::Param { error: Some(_), .. }), "{failure}");
    Ok(())
}

#[test]
fn sets_get_through_a_line_that_loses_a_fifth() {
    for client in Client::ALL {
        for seed in 0..20 {
            let mut rig = rig(client, 0.2, seed);
            persist(&mut rig, 5, |rig| rig.connect());
            let value = persist(&mut rig, 5, |rig| rig.set("RTL_ALT", 45.0));
            assert_eq!(value, Value::F32(45.0), "{client}, seed {seed}");
        }
    }
}
