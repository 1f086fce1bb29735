//! The paper's protocols. Those that score an object at a time are [`Protocol`]s and run through
//! [`crate::evaluate`]; `ablation` runs one of them for several models, [`runtime`] and [`laws`] stand alone.

pub mod laws;
pub mod progressive;
pub mod runtime;
pub mod views;

use crate::Result;
use crate::cases::Subject;
use crate::gallery::Gallery;
use crate::metrics::Judge;
use crate::report::ObjectRecord;
use lumi_model::Relighter;

/// What is asked of a model on each object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Inputs under one light, the same poses under others.
    MultiView,
    /// Inputs under one light, held-out poses under others.
    NovelView,
    /// Ten replacements of the light out of a pool of five, in token space and in pixel space; and lights added
    /// one after the other, where the model was trained for it.
    Progressive,
}

/// A row of [`PROTOCOLS`].
pub struct About {
    /// The protocol.
    pub protocol: Protocol,
    /// Name on the command line and in reports.
    pub name: &'static str,
    /// Input views, where nothing else is asked for.
    pub inputs: usize,
    /// Whether the inputs' own poses are compared (else held-out ones).
    pub same_views: bool,
    /// What evaluates an object.
    object: fn(&Relighter, &Subject, &Judge, &mut Gallery) -> Result<ObjectRecord>,
}

/// Every protocol that scores an object at a time.
pub const PROTOCOLS: &[About] = &[
    About {
        protocol: Protocol::MultiView,
        name: "multi-view",
        inputs: 4,
        same_views: true,
        object: views::object,
    },
    About {
        protocol: Protocol::NovelView,
        name: "novel-view",
        inputs: 8,
        same_views: false,
        object: views::object,
    },
    About {
        protocol: Protocol::Progressive,
        name: "progressive",
        inputs: 8,
        same_views: false,
        object: progressive::object,
    },
];

impl Protocol {
    /// Its row of [`PROTOCOLS`].
    #[must_use]
    pub fn about(self) -> &'static About {
        let row = PROTOCOLS.iter().find(|a| a.protocol == self);
        row.unwrap_or(&PROTOCOLS[0])
    }

    /// Evaluates one object.
    ///
    /// # Errors
    /// If the model refuses the object's views or lights.
    pub fn object(
        self,
        model: &Relighter,
        subject: &Subject,
        judge: &Judge,
        gallery: &mut Gallery,
    ) -> Result<ObjectRecord> {
        (self.about().object)(model, subject, judge, gallery)
    }
}
