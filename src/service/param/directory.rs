//! `@PARAM`: the virtual directory of `param.pck` (P-22).

use core::marker::PhantomData;
use core::task::Poll;

use super::backend::ParamBackend;
use super::external::{AnyExternalParams, BackendRows, ExternalService};
use super::info::Rows;
use super::packed::{self, PackedFile};
use super::requests;
use super::service::ParamService;
use super::table::{ParamChange, ParamTable, TableMut};
use super::vehicle::Parameters;
use crate::dialect::{MavFtpErr, MavParamError};
use crate::service::Cx;
use crate::service::files::{FileAccess, HasFiles, Part, VirtualEntry, VirtualFile};
use crate::types::{Firmware, Peer, Vehicle};

const NAME: &[u8] = b"@PARAM";

impl HasFiles for ParamService {
    type File = TableFile;
}

impl HasFiles for ExternalService {
    type File = BackendFile;
}

/// The file of the parameters that the stack owns.
#[derive(Clone, Copy, Debug)]
pub struct TableFile(PackedFile);

/// The file of the parameters of a backend. It cannot be uploaded, because a backend decides and sets in one call: it could not
/// set all or none.
#[derive(Clone, Copy, Debug)]
pub struct BackendFile(PackedFile);

impl<F> VirtualFile<F> for TableFile
where
    F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
{
    const UPLOAD_ROOM: usize = 1;

    fn name(_: u16) -> &'static [u8] {
        NAME
    }

    fn open(cx: &mut Cx<'_, F>, _: u16, path: &[u8], access: FileAccess) -> Result<Self, MavFtpErr> {
        PackedFile::open(path, cx.parameters.table_mut().count(), access).map(Self)
    }

    fn size(&self, _: &Cx<'_, F>) -> u32 {
        self.0.len()
    }

    fn begin_to_read(&mut self, packet: u8) {
        self.0.set_packet_len(packet);
    }

    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        self.0.read(&cx.parameters.table_mut().rows, offset, out)
    }

    fn entry(cx: &mut Cx<'_, F>, _: u16, index: u16) -> Option<VirtualEntry> {
        packed::entry(cx.parameters.table_mut().count(), index)
    }

    fn take(&self, _: &mut Cx<'_, F>, content: &[u8]) -> Result<Part, MavFtpErr> {
        Ok(if packed::is_complete(content) { Part::Last } else { Part::More { used: 0 } })
    }

    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Poll<Result<(), MavFtpErr>> {
        Poll::Ready(if set_all(cx, from, content) { Ok(()) } else { Err(MavFtpErr::FAIL) })
    }
}

impl<F> VirtualFile<F> for BackendFile
where
    F: Firmware<Parameters: AnyExternalParams, Vehicle: Vehicle + ParamBackend>,
{
    fn name(_: u16) -> &'static [u8] {
        NAME
    }

    fn open(cx: &mut Cx<'_, F>, _: u16, path: &[u8], access: FileAccess) -> Result<Self, MavFtpErr> {
        PackedFile::open(path, cx.parameters.view_mut().count(), access).map(Self)
    }

    fn size(&self, _: &Cx<'_, F>) -> u32 {
        self.0.len()
    }

    fn begin_to_read(&mut self, packet: u8) {
        self.0.set_packet_len(packet);
    }

    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        let count = cx.parameters.view_mut().count();
        self.0.read(&BackendRows { backend: &*cx.vehicle, count }, offset, out)
    }

    fn entry(cx: &mut Cx<'_, F>, _: u16, index: u16) -> Option<VirtualEntry> {
        packed::entry(cx.parameters.view_mut().count(), index)
    }
}

/// Sets the parameters of an uploaded file: all, or none. Returns whether they are set. Checks all values first, as PARAM_SET
/// does, then sets them. They are stored together, because changes are collected. The service's next poll updates its cache.
fn set_all<F>(cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> bool
where
    F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
{
    let Some(records) = packed::Records::new(content) else { return false };
    for record in records {
        let Some(record) = record else { return false };
        let decision = match check(&cx.parameters.table_mut(), &record) {
            Ok(UploadedValue::Same) => Ok(()),
            Ok(UploadedValue::New { index, bits }) => {
                let (vehicle, mut context) = cx.hook();
                vehicle.may_set(&mut context, &ParamChange { index, bits, from: Some(from), table: PhantomData })
            }
            Err(error) => Err(error),
        };
        if let Err(error) = decision {
            if cfg!(feature = "plan-texts") {
                requests::warn(cx.now, cx.texts, from.link, requests::reason(error), &record.name);
            }
            return false;
        }
    }
    for record in packed::Records::new(content).into_iter().flatten().flatten() {
        let mut table = cx.parameters.table_mut();
        let Ok(UploadedValue::New { index, bits }) = check(&table, &record) else { continue };
        table.change(index, bits, cx.shared.normal);
        let (vehicle, mut context) = cx.hook();
        vehicle.parameter_changed(&mut context, &ParamChange { index, bits, from: Some(from), table: PhantomData });
    }
    true
}

/// A valid value of an uploaded file.
enum UploadedValue {
    /// The parameter has it already.
    Same,
    New {
        index: u16,
        bits: u32,
    },
}

/// Checks a parameter of an uploaded file.
fn check(table: &TableMut<'_>, record: &packed::Uploaded) -> Result<UploadedValue, MavParamError> {
    let found = table.rows.find(&record.name).and_then(|index| Some((index, table.get(index)?)));
    let Some((index, (info, old))) = found else { return Err(MavParamError::DOES_NOT_EXIST) };
    match record.value_of(info.param_type()).filter(|bits| info.is_valid(*bits)) {
        None => Err(MavParamError::VALUE_OUT_OF_RANGE),
        Some(bits) if bits == old => Ok(UploadedValue::Same),
        Some(_) if info.is_read_only() => Err(MavParamError::READ_ONLY),
        Some(bits) => Ok(UploadedValue::New { index, bits }),
    }
}
