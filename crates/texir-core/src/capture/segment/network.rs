//! The model itself: an ONNX file, what it takes and gives, and its inference by tract.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use tract_onnx::prelude::*;
use tract_onnx::tract_hir::infer::Factoid;
use tract_onnx::tract_hir::internal::{TractErrorContext, bail};

use super::crop::InputSize;
use super::votes::CropVotes;
use crate::error::{Error, Result};
use crate::raster::Raster;

/// Mean and standard deviation of ImageNet's photos, R, G, B in [0, 1]: what networks trained from its weights expect.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];
/// Longest edge of a model's input, pixels.
const LONGEST_EDGE: i64 = 2048;

type Plan = TypedRunnableModel<TypedModel>;

/// A segmentation model.
#[derive(Debug)]
pub(super) struct Network {
    path: PathBuf,
    graph: InferenceModel,
    /// The image that it takes.
    pub(super) input: InputSize,
    /// Classes that it tells apart.
    classes: usize,
    /// The graph made ready for each size of image, columns × rows.
    plans: Mutex<HashMap<(usize, usize), Arc<Plan>>>,
}

impl Network {
    /// Reads a model, and runs it once: what is wrong with it shows before any long work.
    pub(super) fn open(path: &Path, classes: usize) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::cannot_read(path, e))?;
        let graph = attempt(path, "is no ONNX model that can be read", || read(path, &bytes))?;
        let input = input_size(path, &graph)?;
        let network = Self { path: path.to_owned(), graph, input, classes, plans: Mutex::default() };
        let [width, height] = input.of_image(1, 1);
        network.run(&Raster::filled(width, height, [128; 3]))?;
        Ok(network)
    }

    /// What the model says about a picture of the size that it takes.
    pub(super) fn run(&self, picture: &Raster<[u8; 3]>) -> Result<CropVotes> {
        let [width, height] = picture.size();
        let planes = (0..3)
            .flat_map(|c| picture.data.iter().map(move |pixel| (f32::from(pixel[c]) / 255.0 - MEAN[c]) / DEVIATION[c]));
        let planes: Vec<f32> = planes.collect();
        let plan = self.plan(width, height)?;
        let output = attempt(&self.path, "cannot be run", || {
            let image = Tensor::from_shape(&[1, 3, height, width], &planes)?;
            plan.run(tvec!(image.into()))?.into_iter().next().context("there is no output")
        })?;
        self.votes(&output)
    }

    fn plan(&self, width: usize, height: usize) -> Result<Arc<Plan>> {
        let mut plans = self.plans.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(plan) = plans.get(&(width, height)) {
            return Ok(plan.clone());
        }
        let doing = format!("cannot be made ready for an image of {width}×{height} pixels");
        let plan = attempt(&self.path, &doing, || {
            let shape = [1, 3, height, width];
            self.graph.clone().with_input_fact(0, f32::fact(shape).into())?.into_optimized()?.into_runnable()
        })?;
        let plan = Arc::new(plan);
        plans.insert((width, height), plan.clone());
        Ok(plan)
    }

    fn votes(&self, output: &Tensor) -> Result<CropVotes> {
        let wrong = |what: String| Error::file(&self.path, what);
        let kind = output.datum_type();
        match (kind.is_float(), output.shape()) {
            (true, &[1, found, height, width]) if height * width > 0 => {
                if found != self.classes {
                    return Err(wrong(format!(
                        "output: has {found} classes ({}); expected {}, one for each of the list: give the list that the \
                         model was trained with, in its order",
                        shape(output),
                        self.classes
                    )));
                }
                let scores = output
                    .cast_to::<f32>()
                    .and_then(|scores| Ok(CropVotes::of_scores(width, height, scores.as_slice::<f32>()?)));
                scores.map_err(|e| wrong(format!("output: cannot be read: {e:#}")))
            }
            (false, &([1, height, width] | [1, 1, height, width])) if height * width > 0 && !kind.is_quantized() => {
                let ids = output.cast_to::<i64>().and_then(|ids| Ok(ids.as_slice::<i64>()?.to_vec()));
                let ids = ids.map_err(|e| wrong(format!("output: cannot be read: {e:#}")))?;
                let class = |id: i64| {
                    let class = u16::try_from(id).ok().filter(|class| usize::from(*class) < self.classes);
                    class.ok_or_else(|| {
                        wrong(format!(
                            "output: has the class {id}; expected 0 to {}, the places in the list of classes",
                            self.classes as i64 - 1
                        ))
                    })
                };
                let classes = ids.into_iter().map(class).collect::<Result<_>>()?;
                Ok(CropVotes::Classes(Raster::new(width, height, classes)?))
            }
            _ => Err(wrong(format!(
                "output: is {} of {kind:?}; expected scores, 1×classes×height×width of F32, or classes, 1×height×width of \
                 I64: export the model so that it ends in one of them",
                shape(output)
            ))),
        }
    }
}

/// Numbers with × between them.
fn shape(tensor: &Tensor) -> String {
    tensor.shape().iter().map(usize::to_string).collect::<Vec<_>>().join("×")
}

/// The graph of a file's bytes, with its first output alone: others are for training.
fn read(path: &Path, bytes: &[u8]) -> TractResult<InferenceModel> {
    let onnx = tract_onnx::onnx();
    let mut proto = onnx.proto_model_for_read(&mut &bytes[..])?;
    // Shapes of inner values follow from the image's; those that are written down contradict it where they are symbols.
    proto.graph.iter_mut().for_each(|graph| graph.value_info.clear());
    let parsed = onnx.parse(&proto, path.parent().and_then(Path::to_str))?;
    if let Some(name) = parsed.unresolved_inputs.first() {
        bail!("nothing gives the value {name:?}");
    }
    let mut graph = parsed.model;
    let outputs: Vec<OutletId> = graph.output_outlets()?.iter().copied().take(1).collect();
    graph.set_output_outlets(&outputs)?;
    Ok(graph)
}

/// The image that a graph takes, if it takes one.
fn input_size(path: &Path, graph: &InferenceModel) -> Result<InputSize> {
    let wrong = |what: String| Error::file(path, what);
    let inputs = attempt(path, "has no inputs", || Ok(graph.input_outlets()?.to_vec()))?;
    if inputs.len() != 1 {
        return Err(wrong(format!("inputs: there are {}; expected one, the image: 1×3×height×width", inputs.len())));
    }
    let fact = attempt(path, "has no input", || graph.input_fact(0).cloned())?;
    let name = attempt(path, "has no input", || Ok(graph.node(inputs[0].node).name.clone()))?;
    let image = |found: String| wrong(format!("input {name:?}: {found}; expected 1×3×height×width of F32"));
    match fact.datum_type.concretize() {
        None | Some(DatumType::F32) => {}
        Some(other) => return Err(image(format!("holds {other:?}"))),
    }
    // The sizes that are fixed.
    let edges: Vec<Option<i64>> = fact.shape.dims().map(|dim| dim.concretize()?.to_i64().ok()).collect();
    let shown = edges.iter().map(|edge| edge.map_or("?".to_owned(), |edge| edge.to_string())).collect::<Vec<_>>();
    let shown = format!("is {}", shown.join("×"));
    let &[batch, channels, height, width] = &edges[..] else {
        return Err(image(format!("has {} axes ({shown})", edges.len())));
    };
    if batch.is_some_and(|batch| batch != 1) {
        return Err(image(format!("{shown}, several images at a time")));
    }
    if channels.is_some_and(|channels| channels != 3) {
        let last = if width == Some(3) { ", channels last" } else { "" };
        return Err(image(format!("{shown}{last}")));
    }
    for (edge, axis) in [(height, "height"), (width, "width")] {
        if edge.is_some_and(|edge| !(1..=LONGEST_EDGE).contains(&edge)) {
            return Err(image(format!("{shown}, whose {axis} is not in 1 to {LONGEST_EDGE}")));
        }
    }
    let edge = |edge: Option<i64>| edge.and_then(|edge| usize::try_from(edge).ok());
    Ok(InputSize { width: edge(width), height: edge(height) })
}

/// What tract does with the model; its errors, and its panics over malformed graphs, are the file's.
fn attempt<T>(path: &Path, doing: &str, work: impl FnOnce() -> TractResult<T>) -> Result<T> {
    let expected = "expected a segmentation model as exported to ONNX (opset 9 to 18)";
    // Nothing is left half done that is used again: graphs are cloned or made anew.
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(result) => result.map_err(|e| Error::file(path, format!("{doing}: {e:#}; {expected}"))),
        Err(_) => Err(Error::file(path, format!("{doing}: its graph is malformed; {expected}"))),
    }
}
