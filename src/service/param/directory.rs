//! `@PARAM`: the virtual directory of `param.pck` (P-22).

use core::marker::PhantomData;
use core::task::Poll;

use super::backend::ParamBackend;
use super::external::{AnyExternalParams, BackendRows, ExternalService};
use super::info::Rows;
use super::packed::{self, PackedFile, Place, Record, Uploaded};
use super::requests;
use super::service::ParamService;
use super::table::{ParamChange, ParamTable, TableMut};
use super::vehicle::Parameters;
use crate::dialect::{MavFtpErr, MavParamError};
use crate::service::Cx;
use crate::service::files::{FileAccess, HasFiles, Part, VirtualEntry, VirtualFile};
use crate::types::{Firmware, Peer, Vehicle};

const NAME: &[u8] = b"@PARAM";

/// No parameter has this index.
const NO_PARAM: u16 = u16::MAX;

impl HasFiles for ParamService {
    type File = TableFile;
}

impl HasFiles for ExternalService {
    type File = BackendFile;
}

/// The file of the parameters that the stack owns.
#[derive(Clone, Copy, Debug)]
pub enum TableFile {
    /// It is read.
    Read(PackedFile),
    /// It is uploaded.
    Upload(ParamUpload),
}

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
        let file = PackedFile::open(path, cx.parameters.table_mut().count(), access)?;
        Ok(if access == FileAccess::Read { Self::Read(file) } else { Self::Upload(ParamUpload::NEW) })
    }

    fn size(&self, _: &Cx<'_, F>) -> u32 {
        if let Self::Read(file) = self { file.len() } else { 0 }
    }

    fn begin_to_read(&mut self, packet: u8) {
        if let Self::Read(file) = self {
            file.set_packet_len(packet);
        }
    }

    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        let Self::Read(file) = self else { return Poll::Ready(Err(MavFtpErr::FAIL)) };
        file.read(&cx.parameters.table_mut().rows, offset, out)
    }

    fn entry(cx: &mut Cx<'_, F>, _: u16, index: u16) -> Option<VirtualEntry> {
        packed::entry(cx.parameters.table_mut().count(), index)
    }

    fn take(&self, _: &mut Cx<'_, F>, content: &[u8]) -> Result<Part, MavFtpErr> {
        Ok(if packed::is_complete(content) { Part::Last } else { Part::More { used: 0 } })
    }

    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Poll<Result<(), MavFtpErr>> {
        let Self::Upload(upload) = self else { return Poll::Ready(Err(MavFtpErr::FAIL)) };
        upload.set_all(cx, from, content)
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

/// The maximum number of records that a poll handles. A record calls at most one hook.
const STEP: u8 = 64;

/// An upload of parameters, which sets all of them or none: all are checked, as PARAM_SET does, before the first is set. They are
/// stored together, because changes are collected. A poll handles some of the records, and the next one continues.
#[derive(Clone, Copy, Debug)]
pub struct ParamUpload {
    phase: UploadPhase,
    /// The next record.
    place: Place,
    /// The parameter in the record before it.
    before: u16,
    /// Whether the vehicle was armed when the check began.
    is_armed: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum UploadPhase {
    Check,
    Set,
}

impl ParamUpload {
    const NEW: Self = Self { phase: UploadPhase::Check, place: Place::FIRST, before: NO_PARAM, is_armed: false };

    /// Handles the next records. Pending if there are more.
    fn set_all<F>(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Poll<Result<(), MavFtpErr>>
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
    {
        if self.phase == UploadPhase::Check && !cx.shared.may_change::<F>(from.address.system) {
            // Another system has taken control.
            return Poll::Ready(Err(MavFtpErr::FAIL));
        }
        let is_armed = cx.shared.observed.state.is_armed();
        if self.phase == UploadPhase::Check && self.is_armed != is_armed {
            // What the vehicle has permitted before it armed, it may not permit now.
            *self = Self { is_armed, ..Self::NEW };
        }
        for _ in 0..STEP {
            if !cx.shared.may_continue() {
                break;
            }
            let before = cx.parameters.table_mut().get(self.before).map_or([0; 16], |(info, _)| *info.wire_name());
            let record = match self.place.next(content, before) {
                Record::Damaged => return Poll::Ready(Err(MavFtpErr::FAIL)),
                Record::End if self.phase == UploadPhase::Set => return Poll::Ready(Ok(())),
                Record::End => {
                    *self = Self { phase: UploadPhase::Set, ..Self::NEW };
                    continue;
                }
                Record::Parameter(record) => record,
            };
            match self.handle(cx, from, &record) {
                Ok(index) => self.before = index,
                Err(error) => {
                    if cfg!(feature = "plan-texts") {
                        requests::warn(cx.now, cx.texts, from.link, requests::reason(error), &record.name);
                    }
                    return Poll::Ready(Err(MavFtpErr::FAIL));
                }
            }
        }
        cx.shared.has_acted = true;
        Poll::Pending
    }

    /// Checks a parameter, or sets it. Returns its index.
    fn handle<F>(&self, cx: &mut Cx<'_, F>, from: Peer, record: &Uploaded) -> Result<u16, MavParamError>
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
    {
        let mut table = cx.parameters.table_mut();
        let Value { index, bits, is_new } = check(&table, record, self.phase)?;
        if !is_new {
            return Ok(index);
        }
        let change = ParamChange { index, bits, from: Some(from), table: PhantomData };
        if self.phase == UploadPhase::Set {
            table.change(index, bits, cx.shared.normal);
            let (vehicle, mut context) = cx.hook();
            vehicle.parameter_changed(&mut context, &change);
            return Ok(index);
        }
        let (vehicle, mut context) = cx.hook();
        vehicle.may_set(&mut context, &change)?;
        Ok(index)
    }
}

/// A valid value of an uploaded file.
struct Value {
    index: u16,
    bits: u32,
    /// Whether the parameter has another one.
    is_new: bool,
}

/// Checks a parameter of an uploaded file. A read-only value that the vehicle has changed since it was checked stays: the file must not
/// end there, with a part of its values set.
fn check(table: &TableMut<'_>, record: &Uploaded, phase: UploadPhase) -> Result<Value, MavParamError> {
    let found = table.rows.find(&record.name).and_then(|index| Some((index, table.get(index)?)));
    let Some((index, (info, old))) = found else { return Err(MavParamError::DOES_NOT_EXIST) };
    match record.value_of(info.param_type()).filter(|bits| info.is_valid(*bits)) {
        None => Err(MavParamError::VALUE_OUT_OF_RANGE),
        Some(bits) if bits != old && info.is_read_only() && phase == UploadPhase::Check => {
            Err(MavParamError::READ_ONLY)
        }
        Some(bits) => Ok(Value { index, bits, is_new: bits != old && !info.is_read_only() }),
    }
}
