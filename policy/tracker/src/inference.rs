//! ONNX Runtime, behind the little of it that trackers need. No other file names `ort`.
//!
//! A [`Network`] is loaded and checked at start; from then on [`Network::run`] works on buffers
//! that never move. ONNX Runtime itself allocates inside; the Rust side does not.

use std::path::{Path, PathBuf};

use ort::{
    environment::Environment,
    memory::Allocator,
    session::{
        HasSelectedOutputs, OutputSelector, RunOptions, Session, SessionInputValue,
        builder::GraphOptimizationLevel,
    },
    value::{Outlet, Tensor, TensorElementType, ValueType},
};

/// `ort` keeps the handles of this many inputs and outputs on the stack; more would allocate in
/// every run.
const INPUTS_MAX: usize = 6;
const OUTPUTS_MAX: usize = 4;

/// Why a network cannot be loaded or run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InferenceError {
    /// The library is missing or of another version.
    #[error("ONNX Runtime at {path}: {message}; `make native` fetches the right one")]
    Library {
        /// Where it was looked for.
        path: PathBuf,
        /// What the loader said.
        message: String,
    },
    /// The bytes are no model that this ONNX Runtime can run.
    #[error("model {model}: {message}")]
    Load {
        /// Name of the model.
        model: String,
        /// What ONNX Runtime said.
        message: String,
    },
    /// The model lacks an input or output, or has it in another shape.
    #[error(
        "model {model}: {port} is {found}, this posed expects {wanted}; model and program do not \
         belong together"
    )]
    Port {
        /// Name of the model.
        model: String,
        /// Which input or output.
        port: String,
        /// What the program needs.
        wanted: String,
        /// What the model has.
        found: String,
    },
    /// A run failed.
    #[error("inference failed: {0}")]
    Run(String),
}

/// The loaded ONNX Runtime library. A process can load it once only: load it at the start, and
/// hand out clones.
#[derive(Debug, Clone)]
pub struct Runtime(Environment);

impl Runtime {
    /// Loads the shared library at `path`.
    ///
    /// # Errors
    /// The file is missing, is no ONNX Runtime or is too old, or this process has loaded one
    /// before.
    pub fn load(path: &Path) -> Result<Self, InferenceError> {
        let failed = |message: String| InferenceError::Library {
            path: path.to_owned(),
            message,
        };
        let builder = ort::init_from(path).map_err(|error| failed(error.to_string()))?;
        let environment = builder.with_telemetry(false).build();
        environment
            .map(Self)
            .map_err(|error| failed(error.to_string()))
    }
}

/// An input or output that the program expects: 32-bit floats of a shape. A dimension of `None`
/// is the model's own choice, but fixed.
#[derive(Debug, Clone, Copy)]
pub struct Port {
    /// Its name in the model.
    pub name: &'static str,
    /// Its dimensions.
    pub shape: &'static [Option<usize>],
}

/// A model with `I` inputs and `O` outputs, ready to run on one thread.
pub struct Network<const I: usize, const O: usize> {
    session: Session,
    inputs: [Tensor<f32>; I],
    options: RunOptions<HasSelectedOutputs>,
    outputs: [Vec<f32>; O],
}

impl<const I: usize, const O: usize> Network<I, O> {
    /// Loads the model `bytes` and checks that it has these inputs and outputs and no others.
    /// `model` is its name in errors.
    ///
    /// # Errors
    /// The bytes are no model, or one with other inputs or outputs.
    pub fn load(
        runtime: &Runtime,
        model: &str,
        bytes: &[u8],
        inputs: [Port; I],
        outputs: [Port; O],
    ) -> Result<Self, InferenceError> {
        const {
            assert!(
                I <= INPUTS_MAX && O <= OUTPUTS_MAX,
                "more ports make runs allocate"
            )
        };
        let session = open(runtime, bytes).map_err(|error| InferenceError::Load {
            model: model.to_owned(),
            message: error.to_string(),
        })?;
        let input_shapes = match_ports(model, "input", session.inputs(), &inputs)?;
        let output_shapes = match_ports(model, "output", session.outputs(), &outputs)?;
        let failed = |error: ort::Error| InferenceError::Load {
            model: model.to_owned(),
            message: error.to_string(),
        };
        let mut tensors = Vec::with_capacity(I);
        for shape in &input_shapes {
            let zeros = vec![0.0f32; shape.iter().product()];
            tensors.push(Tensor::from_array((shape.clone(), zeros)).map_err(failed)?);
        }
        let mut selector = OutputSelector::no_default();
        for (port, shape) in outputs.iter().zip(&output_shapes) {
            let tensor =
                Tensor::<f32>::new(&Allocator::default(), shape.clone()).map_err(failed)?;
            selector = selector.with(port.name).preallocate(port.name, tensor);
        }
        let buffers = std::array::from_fn(|index| vec![0.0; output_shapes[index].iter().product()]);
        let Ok(tensors) = <[Tensor<f32>; I]>::try_from(tensors) else {
            unreachable!("one tensor was made for each input")
        };
        Ok(Self {
            session,
            inputs: tensors,
            options: RunOptions::new().map_err(failed)?.with_outputs(selector),
            outputs: buffers,
        })
    }

    /// The numbers of an input, row-major; they stay as they are from run to run.
    pub fn input(&mut self, index: usize) -> &mut [f32] {
        self.inputs[index].extract_tensor_mut().1
    }

    /// The numbers of an output after the last run, row-major; zeros before the first.
    #[must_use]
    pub fn output(&self, index: usize) -> &[f32] {
        &self.outputs[index]
    }

    /// Copies an output of the last run into an input of the next: the state of a recurrent model.
    /// Shapes that differ leave the input as it is.
    pub fn feed_back(&mut self, output: usize, input: usize) {
        let target = self.inputs[input].extract_tensor_mut().1;
        if target.len() == self.outputs[output].len() {
            target.copy_from_slice(&self.outputs[output]);
        }
    }

    /// Runs the model once.
    ///
    /// # Errors
    /// ONNX Runtime refuses; the outputs are then those of the last run that succeeded.
    pub fn run(&mut self) -> Result<(), InferenceError> {
        let failed = |error: ort::Error| InferenceError::Run(error.to_string());
        let inputs: [SessionInputValue<'_>; I] =
            std::array::from_fn(|index| SessionInputValue::from(&self.inputs[index]));
        let results = self
            .session
            .run_with_options(inputs, &self.options)
            .map_err(failed)?;
        for (index, buffer) in self.outputs.iter_mut().enumerate() {
            let (_, numbers) = results[index].try_extract_tensor::<f32>().map_err(failed)?;
            buffer.copy_from_slice(numbers);
        }
        Ok(())
    }
}

fn open(runtime: &Runtime, bytes: &[u8]) -> Result<Session, ort::Error> {
    // One thread and no spinning: the tracker thread works alone, and a pool would only add jitter.
    let session = Session::builder(&runtime.0)?
        .with_optimization_level(GraphOptimizationLevel::Level3)?
        .with_intra_threads(1)?
        .with_inter_threads(1)?
        .with_intra_op_spinning(false)?
        .with_deterministic_compute(true)?
        .commit_from_memory(bytes)?;
    Ok(session)
}

/// The shapes of `wanted` in their order.
fn match_ports(
    model: &str,
    kind: &str,
    found: &[Outlet],
    wanted: &[Port],
) -> Result<Vec<Vec<usize>>, InferenceError> {
    let mismatch = |name: &str, wanted: String, found: String| InferenceError::Port {
        model: model.to_owned(),
        port: format!("{kind} `{name}`"),
        wanted,
        found,
    };
    for outlet in found {
        if !wanted.iter().any(|port| port.name == outlet.name()) {
            let says = outlet.dtype().to_string();
            return Err(mismatch(outlet.name(), "no such one".to_owned(), says));
        }
    }
    let mut shapes = Vec::with_capacity(wanted.len());
    for port in wanted {
        let described = describe(port.shape);
        let Some(outlet) = found.iter().find(|outlet| outlet.name() == port.name) else {
            return Err(mismatch(port.name, described, "missing".to_owned()));
        };
        let Some(shape) = fixed_shape(outlet.dtype(), port.shape) else {
            return Err(mismatch(port.name, described, outlet.dtype().to_string()));
        };
        shapes.push(shape);
    }
    Ok(shapes)
}

/// The tensor's dimensions if it holds 32-bit floats and fits.
fn fixed_shape(found: &ValueType, wanted: &[Option<usize>]) -> Option<Vec<usize>> {
    let ValueType::Tensor {
        ty: TensorElementType::Float32,
        shape,
        ..
    } = found
    else {
        return None;
    };
    if shape.len() != wanted.len() {
        return None;
    }
    let fit = |(&found, &wanted): (&i64, &Option<usize>)| match (usize::try_from(found), wanted) {
        (Ok(found), None) => Some(found),
        (Ok(found), Some(wanted)) if found == wanted => Some(found),
        // A dynamic dimension takes what the program wants.
        (Err(_), Some(wanted)) => Some(wanted),
        _ => None,
    };
    shape.iter().zip(wanted).map(fit).collect()
}

fn describe(shape: &[Option<usize>]) -> String {
    let dimension = |size: &Option<usize>| size.map_or("n".to_owned(), |size| size.to_string());
    let dimensions: Vec<String> = shape.iter().map(dimension).collect();
    format!("32-bit floats ({})", dimensions.join(", "))
}

/// The one runtime that all tests of this crate share.
#[cfg(test)]
pub(crate) fn shared_runtime() -> Runtime {
    static SHARED: std::sync::OnceLock<Runtime> = std::sync::OnceLock::new();
    let load = || {
        let path = std::env::var_os("ORT_DYLIB_PATH").expect("cargo sets ORT_DYLIB_PATH");
        Runtime::load(Path::new(&path)).expect("run `make native` first")
    };
    SHARED.get_or_init(load).clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = 2 x + state, next = x + state, written by policy/training/fixtures/running_sum.py.
    const RUNNING_SUM: &[u8] = include_bytes!("../tests/data/running_sum.onnx");
    const ROW: &[Option<usize>] = &[Some(1), Some(3)];
    const INPUTS: [Port; 2] = [
        Port {
            name: "x",
            shape: ROW,
        },
        Port {
            name: "state",
            shape: &[Some(1), None],
        },
    ];
    const OUTPUTS: [Port; 2] = [
        Port {
            name: "next",
            shape: ROW,
        },
        Port {
            name: "y",
            shape: ROW,
        },
    ];

    #[test]
    fn a_stateful_model_runs_on_its_own_buffers() {
        let mut sum: Network<2, 2> =
            Network::load(&shared_runtime(), "sum", RUNNING_SUM, INPUTS, OUTPUTS).unwrap();
        for step in 1..=4u8 {
            sum.input(0).copy_from_slice(&[1.0, 10.0, -0.5]);
            sum.run().unwrap();
            sum.feed_back(0, 1);
            let n = f32::from(step);
            assert_eq!(sum.output(0), [n, 10.0 * n, -0.5 * n]);
            assert_eq!(sum.output(1), [n + 1.0, 10.0 * (n + 1.0), -0.5 * (n + 1.0)]);
        }
    }

    #[test]
    fn a_missing_library_is_named() {
        let error = Runtime::load(Path::new("/nowhere/libonnxruntime.so")).unwrap_err();
        assert!(
            error.to_string().contains("/nowhere/libonnxruntime.so"),
            "{error}"
        );
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let load = |bytes: &[u8], inputs: [Port; 2]| {
            Network::<2, 2>::load(&shared_runtime(), "sum", bytes, inputs, OUTPUTS)
                .err()
                .unwrap()
        };
        let mut wide = INPUTS;
        wide[0].shape = &[Some(1), Some(4)];
        let text = load(RUNNING_SUM, wide).to_string();
        assert!(
            text.contains("input `x`") && text.contains("(1, 4)"),
            "{text}"
        );
        assert!(text.contains('3'), "{text}");
        let mut other = INPUTS;
        other[1].name = "memory";
        let text = load(RUNNING_SUM, other).to_string();
        assert!(
            text.contains("input `state`") && text.contains("no such one"),
            "{text}"
        );
        for cut in [0, 10, RUNNING_SUM.len() / 2] {
            let error = load(&RUNNING_SUM[..cut], INPUTS);
            assert!(matches!(
                error,
                InferenceError::Load { .. } | InferenceError::Port { .. }
            ));
        }
    }
}
