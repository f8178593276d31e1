//! Why stored content was not restored (G-18).

/// Why stored content was not restored, or not completely. A STATUSTEXT reports it, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RestoreError {
    /// A part of the storage could not be read, and nothing is in use that may be older than it.
    ///
    /// Reading is repeated every second. Content that can be read then is restored late. After the fourth attempt a
    /// page that cannot be read counts as damaged, or as cut off by a loss of power. While no page at all can be read,
    /// reading is repeated every ten seconds. Nothing is written before.
    // Not 0, so that no error is 0, and a stack without storage is all zeros.
    Unreadable = 1,
    /// The newest content is damaged. Plans and parameters are restored from an older record, if there is one. The
    /// damage is reported at each start until new content is stored.
    Damaged,
    /// Newer firmware wrote the content in a format that this version does not know. It remains until new content is
    /// stored.
    Foreign,
    /// The region has data but no journal. It is erased unit by unit as the journal grows.
    OtherData,
}

impl core::fmt::Display for RestoreError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Unreadable => "the storage cannot be read, reading is repeated: check the driver and the wiring",
            Self::Damaged => "the stored data is damaged: store it again",
            Self::Foreign => "newer firmware wrote the stored data: install that firmware, or store the data again",
            Self::OtherData => "the region holds other data, which will be erased: check the region's address",
        })
    }
}

impl core::error::Error for RestoreError {}

/// The content that was not restored, and why. A STATUSTEXT reports each, too. Everything else was restored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct RestoreErrors {
    /// The signing key. Links that need one stay closed (G-18).
    pub signing: Option<RestoreError>,
    /// The parameters. They have their defaults, or the values of an older record if the newest one is damaged.
    pub parameters: Option<RestoreError>,
    /// The plans. They are empty, or those of an older record if the newest one is damaged. There may have been another
    /// geofence.
    pub plans: Option<RestoreError>,
    /// One of the firmware's own records.
    pub records: Option<RestoreError>,
    /// The region as a whole.
    pub region: Option<RestoreError>,
}

impl RestoreErrors {
    pub(crate) const NONE: Self = Self { signing: None, parameters: None, plans: None, records: None, region: None };

    /// Returns whether everything was restored. Call it in each pass of the loop, because content that cannot be read
    /// at first may be restored later:
    ///
    /// ```
    /// # use mavstack::StackOf;
    /// # #[derive(mavstack::Stack)]
    /// # #[stack(vehicle: Rover, links: 1, storage)]
    /// # struct Mavlink;
    /// # struct Rover { may_arm: bool }
    /// # impl mavstack::Vehicle for Rover { fn state(&self) -> Option<mavstack::VehicleState> { None } }
    /// # impl mavstack::Commands for Rover {
    /// #     fn command(&mut self, _: &mut mavstack::Context<'_>, _: &mavstack::Command) -> mavstack::Outcome {
    /// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
    /// #     }
    /// # }
    /// # fn pass(stack: &StackOf<Mavlink>, rover: &mut Rover) {
    /// rover.may_arm = !stack.is_restoring() && stack.restore_errors().is_empty();
    /// # }
    /// ```
    pub fn is_empty(&self) -> bool {
        *self == Self::NONE
    }

    /// Returns an error if there is any.
    pub(crate) fn result(self) -> Result<(), Self> {
        if self.is_empty() { Ok(()) } else { Err(self) }
    }
}

impl core::fmt::Display for RestoreErrors {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { signing, parameters, plans, records, region } = self;
        let mut separator = "";
        let parts = [
            ("signing key", signing),
            ("parameters", parameters),
            ("plans", plans),
            ("records", records),
            ("region", region),
        ];
        for (name, error) in parts {
            if let Some(error) = error {
                write!(f, "{separator}{name}: {error}")?;
                separator = "; ";
            }
        }
        Ok(())
    }
}

impl core::error::Error for RestoreErrors {}
