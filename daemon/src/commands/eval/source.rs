//! The trackers that are evaluated.

use posed_body::{motion::Clip, scene::Scene};
use posed_tracker::{
    Ik, Physical, Tracker, TrackerKind, eval::Options, hmd_nemo, inference::InferenceError, pip,
    questsim,
};

use crate::{cli::EvalArgs, commands::CommandError, models::Models};

/// Where trackers come from.
pub(super) struct Source {
    kind: TrackerKind,
    models: Option<Models>,
    /// A model in place of the built-in one: its name and content.
    model: Option<(String, Vec<u8>)>,
    options: hmd_nemo::Options,
    pip: pip::Options,
}

impl Source {
    /// Loads what the arguments name.
    ///
    /// # Errors
    /// ONNX Runtime or the model's file cannot be had.
    pub(super) fn new(args: &EvalArgs) -> Result<Self, CommandError> {
        let models = match args.tracker {
            TrackerKind::Ik => None,
            _ => Some(Models::load().map_err(|error| CommandError::Input(error.to_string()))?),
        };
        let model = match &args.model {
            Some(path) => {
                let bytes = std::fs::read(path).map_err(|error| CommandError::file(path, error))?;
                Some((path.display().to_string(), bytes))
            }
            None => None,
        };
        Ok(Self {
            kind: args.tracker,
            models,
            model,
            options: hmd_nemo::Options {
                refine: !args.unrefined,
                mirror: !args.unmirrored,
                ..hmd_nemo::Options::default()
            },
            pip: pip::Options {
                physics: args.without.unwrap_or_default(),
            },
        })
    }

    /// A fresh tracker for a clip's mover.
    ///
    /// # Errors
    /// The model does not fit this program, or there is none.
    pub(super) fn tracker(
        &self,
        options: &Options,
        clip: &Clip,
        args: &EvalArgs,
    ) -> Result<Box<dyn Tracker>, CommandError> {
        let tracker = self.kinematic()?;
        if !args.physics {
            return Ok(tracker);
        }
        let wearer = options.bones.wearer(clip);
        Ok(Box::new(Physical::new(tracker, &wearer, args.rate)))
    }

    fn kinematic(&self) -> Result<Box<dyn Tracker>, CommandError> {
        let Some(models) = &self.models else {
            return Ok(Box::new(Ik::default()));
        };
        let problem = |error: InferenceError| CommandError::Input(error.to_string());
        let model = self.model.as_ref();
        let model = model.map(|(name, bytes)| (name.as_str(), bytes.as_slice()));
        if self.kind == TrackerKind::QuestSim {
            let options = questsim::Options::default();
            return Ok(Box::new(models.questsim(model, options).map_err(problem)?));
        }
        if self.kind == TrackerKind::HmdNemo {
            let tracker = models.hmd_nemo(model, self.options).map_err(problem)?;
            return Ok(Box::new(tracker));
        }
        if self.kind == TrackerKind::Pip {
            let tracker = models.pip(model, self.pip).map_err(problem)?;
            return Ok(Box::new(tracker));
        }
        let found = models
            .tracker(self.kind, &Scene::default())
            .map_err(problem)?;
        found.ok_or_else(|| {
            let name = self.kind.name();
            CommandError::Input(format!("this build has no model for the tracker {name}"))
        })
    }
}
