//! Parameters that are declared at startup.

use mavstack::param::{ParamFault, ParamInfo, RuntimeTable};

/// A plug-in module adds its parameters.
fn add_winch<const N: usize>(table: &mut RuntimeTable<N>) -> Result<(), ParamFault> {
    table.add(ParamInfo::new("WINCH_LEN", 20.0, 0.0..=50.0)?)?;
    table.add(ParamInfo::new("WINCH_ON", 0i32, 0..=1)?.read_only())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_module_fits() {
        assert!(add_winch(&mut RuntimeTable::<2>::new()).is_ok());
        assert!(add_winch(&mut RuntimeTable::<1>::new()).is_err());
    }
}
