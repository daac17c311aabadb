//! The trained models that are built in, and the ONNX Runtime that runs them.

use std::{env, path::PathBuf};

use posed_body::scene::Scene;
use posed_tracker::{
    HmdNemo, Pip, QuestSim, Tracker, TrackerKind, hmd_nemo,
    inference::{InferenceError, Runtime},
    pip, questsim,
};

/// HMD-NeMo; its card lies beside it.
static HMD_NEMO: &[u8] = include_bytes!("../../policy/models/hmd_nemo_small.onnx");
/// PIP's networks.
static PIP: &[u8] = include_bytes!("../../policy/models/pip_small.onnx");
/// QuestSim's policy.
static QUESTSIM: &[u8] = include_bytes!("../../policy/models/questsim.onnx");
/// The library's file name, of the version that posed is built against.
const LIBRARY: &str = "libonnxruntime.so.1.31.1";

/// The models, with the runtime loaded once for the process.
#[derive(Debug, Clone)]
pub struct Models {
    runtime: Runtime,
}

impl Models {
    /// Loads ONNX Runtime: the file that `ORT_DYLIB_PATH` names, else the one installed with
    /// posed (`../lib/posed` beside the program's folder), else the system's.
    ///
    /// # Errors
    /// There is none, or it is too old; or this process has loaded one before.
    pub fn load() -> Result<Self, InferenceError> {
        Runtime::load(&library()).map(|runtime| Self { runtime })
    }

    /// A fresh tracker of a kind that needs a model; `None` for one that has no model here. What is
    /// simulated is so in `scene`.
    ///
    /// # Errors
    /// The model does not fit this program.
    pub fn tracker(
        &self,
        kind: TrackerKind,
        scene: &Scene,
    ) -> Result<Option<Box<dyn Tracker>>, InferenceError> {
        Ok(match kind {
            TrackerKind::HmdNemo => {
                let options = hmd_nemo::Options::default();
                Some(Box::new(self.hmd_nemo(None, options)?))
            }
            TrackerKind::Pip => Some(Box::new(self.pip(None, pip::Options::default())?)),
            TrackerKind::QuestSim => {
                let options = questsim::Options {
                    scene: scene.clone(),
                    ..questsim::Options::default()
                };
                Some(Box::new(self.questsim(None, options)?))
            }
            TrackerKind::Ik => None,
        })
    }

    /// PIP with these options, and with another model than the built-in one where one is given by
    /// name and content.
    ///
    /// # Errors
    /// The model does not fit this program.
    pub fn pip(
        &self,
        model: Option<(&str, &[u8])>,
        options: pip::Options,
    ) -> Result<Pip, InferenceError> {
        let (name, bytes) = model.unwrap_or(("pip_small.onnx", PIP));
        Pip::load(&self.runtime, name, bytes, options)
    }

    /// QuestSim with these options, and with another model than the built-in one where one is
    /// given; HMD-NeMo stands in where its character cannot show the wearer.
    ///
    /// # Errors
    /// A model does not fit this program.
    pub fn questsim(
        &self,
        model: Option<(&str, &[u8])>,
        options: questsim::Options,
    ) -> Result<QuestSim, InferenceError> {
        let (name, bytes) = model.unwrap_or(("questsim.onnx", QUESTSIM));
        let stand_in = Box::new(self.hmd_nemo(None, hmd_nemo::Options::default())?);
        QuestSim::load(&self.runtime, name, bytes, stand_in, options)
    }

    /// HMD-NeMo with these options, and with another model than the built-in one where one is
    /// given by name and content.
    ///
    /// # Errors
    /// The model does not fit this program.
    pub fn hmd_nemo(
        &self,
        model: Option<(&str, &[u8])>,
        options: hmd_nemo::Options,
    ) -> Result<HmdNemo, InferenceError> {
        let (name, bytes) = model.unwrap_or(("hmd_nemo_small.onnx", HMD_NEMO));
        HmdNemo::load(&self.runtime, name, bytes, options)
    }
}

fn library() -> PathBuf {
    if let Some(path) = env::var_os("ORT_DYLIB_PATH") {
        return path.into();
    }
    let program = env::current_exe().unwrap_or_default();
    let installed = program
        .parent()
        .and_then(|bin| bin.parent())
        .map(|prefix| prefix.join("lib/posed").join(LIBRARY));
    installed
        .filter(|path| path.exists())
        .unwrap_or_else(|| LIBRARY.into())
}
