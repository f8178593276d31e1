//! Transactions that a driver is expected to make on an SPI bus.

use embedded_hal_mock::eh1::spi::Transaction;

pub type Bus = Vec<Transaction<u8>>;

/// One transaction: the chip is selected once.
pub fn selected(operations: impl IntoIterator<Item = Transaction<u8>>) -> Bus {
    let mut bus = vec![Transaction::transaction_start()];
    bus.extend(operations);
    bus.push(Transaction::transaction_end());
    bus
}

pub fn command(bytes: &[u8]) -> Bus {
    selected([Transaction::write_vec(bytes.to_vec())])
}

pub fn question(bytes: &[u8], answer: &[u8]) -> Bus {
    selected([Transaction::write_vec(bytes.to_vec()), Transaction::read_vec(answer.to_vec())])
}

pub fn written(bytes: &[u8], data: &[u8]) -> Bus {
    selected([Transaction::write_vec(bytes.to_vec()), Transaction::write_vec(data.to_vec())])
}
