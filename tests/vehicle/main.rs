//! What a vehicle reports, its parameters, and manual control.

#[path = "../support/mod.rs"]
mod support;

mod components;
mod gimbal;
mod gimbal_control;
mod gimbal_device;
mod gimbal_properties;
mod heartbeat;
mod instances;
mod left_out;
mod manual_control;
mod manual_properties;
mod messages;
#[cfg(feature = "fmt")]
mod metadata;
mod operator_control;
mod operator_lossy;
mod operator_model;
mod own_messages;
mod param_backend;
mod param_places;
mod param_reset;
mod param_run_time;
mod params;
mod rc_over_mavlink;
mod setpoint_properties;
mod setpoints;
mod si_values;
mod statustext;
mod streams;
#[cfg(feature = "storage")]
mod system_id;
mod time;
