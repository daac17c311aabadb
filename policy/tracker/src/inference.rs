//! ONNX Runtime, behind the little of it that trackers need. No other file names `ort`.
//!
//! A [`Network`] is loaded and checked at start; from then on [`Network::run`] works on buffers
//! that never move. ONNX Runtime itself allocates inside; the Rust side does not.

use std::{
    ffi::CString,
    path::{Path, PathBuf},
};

use ort::{
    AsPointer,
    environment::Environment,
    memory::Allocator,
    session::{Session, builder::GraphOptimizationLevel},
    value::{Outlet, Tensor, TensorElementType, ValueType},
};

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
    input_names: [CString; I],
    inputs: [Tensor<f32>; I],
    output_names: [CString; O],
    outputs: [Tensor<f32>; O],
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
        let failed = |error: ort::Error| InferenceError::Load {
            model: model.to_owned(),
            message: error.to_string(),
        };
        let session = open(runtime, bytes).map_err(failed)?;
        let input_shapes = match_ports(model, "input", session.inputs(), inputs)?;
        let output_shapes = match_ports(model, "output", session.outputs(), outputs)?;
        Ok(Self {
            session,
            input_names: inputs.map(|port| c_name(&port)),
            inputs: tensors(input_shapes).map_err(failed)?,
            output_names: outputs.map(|port| c_name(&port)),
            outputs: tensors(output_shapes).map_err(failed)?,
        })
    }

    /// The numbers of an input, row-major; they stay as they are from run to run.
    pub fn input(&mut self, index: usize) -> &mut [f32] {
        self.inputs[index].extract_tensor_mut().1
    }

    /// The numbers of an output after the last run, row-major; zeros before the first.
    #[must_use]
    pub fn output(&self, index: usize) -> &[f32] {
        self.outputs[index].extract_tensor().1
    }

    /// Copies an output of the last run into an input of the next: the state of a recurrent model.
    /// Where their sizes differ the input stays as it is.
    pub fn feed_back(&mut self, output: usize, input: usize) {
        let source = self.outputs[output].extract_tensor().1;
        let target = self.inputs[input].extract_tensor_mut().1;
        if target.len() == source.len() {
            target.copy_from_slice(source);
        }
    }

    /// Runs the model once. `ort`'s own call collects its arguments on the heap when there are more
    /// than a few, so this one goes to the library below it.
    ///
    /// # Errors
    /// ONNX Runtime refuses; the outputs are then of no use.
    #[expect(
        unsafe_code,
        reason = "the C function that runs a session has no other interface"
    )]
    pub fn run(&mut self) -> Result<(), InferenceError> {
        let input_names = self.input_names.each_ref().map(|name| name.as_ptr());
        let output_names = self.output_names.each_ref().map(|name| name.as_ptr());
        let inputs = self.inputs.each_ref().map(AsPointer::ptr);
        let mut outputs = self.outputs.each_mut().map(AsPointer::ptr_mut);
        // SAFETY: the names are terminated, there are as many as values, and all live in `self`,
        // which is borrowed for the call. The outputs exist already, with the shapes that the
        // model promises, so that the library writes into them and makes none of its own.
        let status = unsafe {
            (ort::api().Run)(
                self.session.ptr_mut(),
                std::ptr::null(),
                input_names.as_ptr(),
                inputs.as_ptr(),
                I,
                output_names.as_ptr(),
                O,
                outputs.as_mut_ptr(),
            )
        };
        // SAFETY: the status comes from the call above and is given away here.
        let result = unsafe { ort::Error::<()>::result_from_status(status) };
        result.map_err(|error| InferenceError::Run(error.to_string()))
    }
}

fn c_name(port: &Port) -> CString {
    CString::new(port.name).unwrap_or_default()
}

/// One tensor of zeros for each shape.
fn tensors<const N: usize>(shapes: [Vec<usize>; N]) -> Result<[Tensor<f32>; N], ort::Error> {
    let mut made = Vec::with_capacity(N);
    for shape in shapes {
        let mut tensor = Tensor::<f32>::new(&Allocator::default(), shape)?;
        tensor.extract_tensor_mut().1.fill(0.0);
        made.push(tensor);
    }
    match <[Tensor<f32>; N]>::try_from(made) {
        Ok(tensors) => Ok(tensors),
        Err(_) => unreachable!("one tensor was made for each shape"),
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
fn match_ports<const N: usize>(
    model: &str,
    kind: &str,
    found: &[Outlet],
    wanted: [Port; N],
) -> Result<[Vec<usize>; N], InferenceError> {
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
    let mut shapes = [const { Vec::new() }; N];
    for (slot, port) in shapes.iter_mut().zip(wanted) {
        let described = describe(port.shape);
        let Some(outlet) = found.iter().find(|outlet| outlet.name() == port.name) else {
            return Err(mismatch(port.name, described, "missing".to_owned()));
        };
        let Some(shape) = fixed_shape(outlet.dtype(), port.shape) else {
            return Err(mismatch(port.name, described, outlet.dtype().to_string()));
        };
        *slot = shape;
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
