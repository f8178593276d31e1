//! Component metadata over HTTP, from which QGroundControl shows the parameters' units and ranges.

use std::net::Ipv4Addr;
use std::thread;

use mavstack::dialect::ComponentMetadata;
use mavstack::{Text, metadata};
use mavstack_demo::Tuning;
use tiny_http::{Header, Response, Server};

/// Serves the files on a port of this machine for as long as the program runs. Returns the COMPONENT_METADATA that refers to
/// them.
pub fn serve(port: u16) -> Result<&'static ComponentMetadata, String> {
    let server = Server::http((Ipv4Addr::LOCALHOST, port)).map_err(|error| format!("port {port}: {error}"))?;
    let uri = |file: &str| format!("http://127.0.0.1:{port}/{file}");
    let (mut parameters, mut general) = (String::new(), String::new());
    metadata::parameters::<Tuning>(&mut parameters).map_err(|error| error.to_string())?;
    let crc = metadata::file_crc(parameters.as_bytes());
    metadata::general(&mut general, &uri("parameters.json"), crc).map_err(|error| error.to_string())?;
    let file_crc = metadata::file_crc(general.as_bytes());
    thread::spawn(move || {
        let json = "Content-Type: application/json".parse::<Header>().ok();
        for request in server.incoming_requests() {
            let file = match request.url() {
                "/general.json" => &general,
                "/parameters.json" => &parameters,
                _ => {
                    // An error means that the client has disconnected.
                    let _ = request.respond(Response::empty(404));
                    continue;
                }
            };
            let mut response = Response::from_string(file.as_str());
            if let Some(json) = &json {
                response.add_header(json.clone());
            }
            let _ = request.respond(response);
        }
    });
    let metadata = ComponentMetadata { time_boot_ms: 0, file_crc, uri: Text::new(&uri("general.json")) };
    // Leaked because it is needed for as long as the program runs.
    Ok(Box::leak(Box::new(metadata)))
}
