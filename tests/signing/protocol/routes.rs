//! What a link learns from frames that signing does not vouch for: rules R-3, G-9, G-11.

use super::*;

/// R-3, G-9: a frame that is accepted unsigned as an exception teaches no route. Otherwise a forged one could keep a ground
/// station's frames from that radio for good.
#[test]
fn unsigned_exception_teaches_no_route() {
    let signing = [LinkSigning::SIGNED, LinkSigning::OPEN];
    let links = signing.map(|signing| LinkConfig::uart(115_200).with_signing(signing));
    let mut rig = Rig::<2, SignedForwarded>::new(links);
    rig.set_key(KEY);
    for link in [0, 1] {
        assert!(!rig.transmit(link).is_empty(), "the first heartbeats");
    }
    rig.receive(0, &Signer::new(KEY).unsigned(Version::V2, &RadioStatus::default()));
    assert_eq!((rig.vehicle.calls.len(), rig.stack.peers(rig.now).count()), (1, 1), "it is handled all the same");
    let frame = Signer::new(KEY).unsigned(Version::V2, &Gcs::heartbeat());
    rig.receive(1, &frame);
    assert!(rig.transmit(0).iter().any(|sent| sent.raw == frame));
}

/// R-3, G-11: neither does SETUP_SIGNING, which any peer may send as long as there is no key, signed with any key.
#[test]
fn first_key_teaches_no_route() {
    let signing = [LinkSigning::REQUIRED.with_provisioning(), LinkSigning::OPEN];
    let links = signing.map(|signing| LinkConfig::uart(115_200).with_signing(signing));
    let mut rig = Rig::<2, SignedForwarded>::new(links);
    for link in [0, 1] {
        assert!(!rig.transmit(link).is_empty(), "the first heartbeats");
    }
    let setup = SetupSigning { target_system: 1, target_component: 1, secret_key: Secret(KEY), initial_timestamp: NOW };
    rig.receive(0, &Signer::new(OTHER_KEY).frame(&setup));
    assert_eq!((rig.counters().setups, rig.stack.peers(rig.now).count()), (1, 1), "it is carried out all the same");
    rig.transmit(0);
    let frame = Signer::new(KEY).unsigned(Version::V2, &Gcs::heartbeat());
    rig.receive(1, &frame);
    assert!(rig.transmit(0).iter().any(|sent| sent.raw == frame));
}
