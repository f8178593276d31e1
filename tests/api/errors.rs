//! Error messages: what failed, and what to do.

use mavstack::dialect::MavMissionResult;
use mavstack::frame::EncodeError;
use mavstack::io::SerialError;
use mavstack::network::LinkError;
use mavstack::plan::PlanFault;
use mavstack::wpl::{Fault, HomeRow, Reader};

#[test]
fn encoding_errors_say_what_to_do() {
    let texts = [EncodeError::BufferTooSmall, EncodeError::NeedsV2].map(|error| error.to_string());
    assert!(texts[0].contains("MAX_FRAME_LEN"), "{texts:?}");
    assert!(texts[1].contains("Version::V2"), "{texts:?}");
}

/// A transport's error is shown in its own words.
#[test]
fn link_errors_say_what_to_do() {
    let read = LinkError::Read(SerialError::Line).to_string();
    assert_eq!(read, "reading failed: Line");
    assert_eq!(LinkError::Write(SerialError::WouldBlock).to_string(), "writing failed: WouldBlock");
    let closed = LinkError::<SerialError>::Closed.to_string();
    assert!(closed.contains("restart the link"), "{closed}");
    let missing = LinkError::<SerialError>::NoSuchLink.to_string();
    assert!(missing.contains("count from 0"), "{missing}");
}

#[test]
fn uart_errors_say_what_to_do() {
    use embedded_io::Error as _;
    for (error, word) in [
        (SerialError::Overrun, "make the queue longer"),
        (SerialError::Line, "the UART reported an error"),
        (SerialError::WouldBlock, "write_ready"),
    ] {
        assert!(error.to_string().contains(word), "{error}");
        assert_eq!(error.kind(), embedded_io::ErrorKind::Other);
    }
}

#[cfg(any(feature = "embedded-hal-nb", feature = "embedded-io-06", feature = "embedded-io-async"))]
#[test]
fn adapter_errors_say_what_to_do() {
    use embedded_io::Error as _;
    use mavstack::io::HalError;
    let error = HalError::Hal(embedded_io::ErrorKind::TimedOut);
    assert_eq!((error.to_string(), error.kind()), ("TimedOut".to_owned(), embedded_io::ErrorKind::Other));
    assert!(HalError::<SerialError>::WouldBlock.to_string().contains("read_ready"));
}

/// M-38: the message names the item, if one is at fault.
#[test]
fn plan_errors_name_the_item() {
    let fault = |seq| PlanFault { seq, result: MavMissionResult::NO_SPACE }.to_string();
    assert!(fault(Some(7)).starts_with("item 7"), "{}", fault(Some(7)));
    assert!(fault(None).starts_with("plan refused"), "{}", fault(None));
}

/// Every error in a plan's text has a line, a column and a reason.
#[test]
fn plan_text_errors_name_line_and_column() {
    let row = |text: &str| format!("QGC WPL 110\n{text}\n");
    let good = "0\t0\t0\t16\t0\t0\t0\t0\t1\t2\t3\t1";
    for (text, expected) in [
        ("QGC 110\n".to_owned(), "line 1: not a QGC WPL file"),
        ("QGC WPL 7\n".to_owned(), "line 1: version is not 110 or 120"),
        (row("0\t0"), "line 2: not 12 columns"),
        (row(&good.replacen("16", "x", 1)), "line 2 command: not a number"),
        (row(&good.replacen("16", "99999", 1)), "line 2 command: number out of range"),
        (row("0\t0\t2\t16\t0\t0\t0\t0\t0.5\t2\t3\t1"), "line 2 x: not a whole number"),
        (row(&good.replacen("16", &"1".repeat(90), 1)), "line 2 command: too long"),
        (row(&good.replacen("0\t0\t0\t16", "0\t0\t77\t16", 1)), "line 2 frame: unknown frame"),
        (row(&good.replacen("0\t0\t0\t16\t0", "0\t0\t0\t177\t9", 1)), "line 2 param1: no row to jump to"),
        (row(&good.replacen('0', "5", 1)), "line 2 index: not in sequence"),
    ] {
        let mut reader = Reader::new(HomeRow::None).numbered();
        let mut bytes = text.as_bytes();
        let error = loop {
            match reader.next(&mut bytes) {
                Ok(Some(_)) => {}
                Ok(None) => break reader.finish().expect_err(&text),
                Err(error) => break error,
            }
        };
        assert_eq!(error.to_string(), expected);
    }
    assert_eq!(Fault::TooMany.to_string(), "too many rows");
}
