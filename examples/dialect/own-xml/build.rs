//! Generates the module `crane` from `crane.xml`.

fn main() {
    mavstack_dialect::Build::new("crane.xml").beside_common().run();
}
