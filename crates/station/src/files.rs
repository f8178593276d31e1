//! Files, by MAVLink FTP.
