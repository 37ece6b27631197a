//! ONNX files in code: networks that know paints.

use prost::Message;
use tract_onnx::pb::tensor_shape_proto::{Dimension, dimension};
use tract_onnx::pb::{
    AttributeProto, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, TensorProto, TensorShapeProto, TypeProto,
    ValueInfoProto, attribute_proto, tensor_proto, type_proto,
};

const FLOAT: i32 = tensor_proto::DataType::Float as i32;
pub const FLOAT16: i32 = tensor_proto::DataType::Float16 as i32;
const INT64: i32 = tensor_proto::DataType::Int64 as i32;

/// An axis of the input.
#[derive(Clone, Copy, Debug)]
pub enum Axis {
    Fixed(i64),
    Free(&'static str),
}

/// What becomes of the scores.
#[derive(Clone, Copy, Debug)]
pub enum Head {
    /// As they are.
    Scores,
    /// At a quarter of the resolution.
    Quarter,
    /// The best class.
    Classes { keep_axis: bool },
    /// The best class, with numbers that go beyond the list.
    Shifted,
    /// One number per class.
    Vector,
    /// An operation that does not exist.
    Unknown,
    /// The first class within so many pixels from the border.
    Framed(i64),
    /// No number.
    Nan,
}

/// A network of one convolution that scores each pixel by how near it is to each of the colours.
#[derive(Clone, Debug)]
pub struct Model {
    pub input: Vec<Axis>,
    pub element: i32,
    pub inputs: usize,
    pub head: Head,
    pub colors: Vec<[f32; 3]>,
}

impl Model {
    /// `colors` as encoded in photos.
    pub fn new(input: &[Axis], head: Head, colors: impl Iterator<Item = [f32; 3]>) -> Self {
        Self { input: input.to_vec(), element: FLOAT, inputs: 1, head, colors: colors.collect() }
    }

    /// The file.
    pub fn bytes(&self) -> Vec<u8> {
        let name = |i: usize| if i == 0 { "image".to_owned() } else { format!("image {i}") };
        // −|x − c|² without what all classes share, sharpened; x and c less ImageNet's mean, over its deviation.
        let normal = |c: &[f32; 3]| -> [f32; 3] {
            std::array::from_fn(|i| (c[i] - [0.485, 0.456, 0.406][i]) / [0.229, 0.224, 0.225][i])
        };
        let classes = self.colors.len() as i64;
        let weights: Vec<f32> = self.colors.iter().flat_map(|c| normal(c).map(|v| 40.0 * v)).collect();
        let biases = self.colors.iter().map(|c| -20.0 * normal(c).map(|v| v * v).iter().sum::<f32>()).collect();
        let mut constants = vec![floats("weights", &[classes, 3, 1, 1], weights), floats("biases", &[classes], biases)];
        let mut nodes = vec![node("Conv", &["image", "weights", "biases"], "scores", vec![])];
        match self.head {
            Head::Scores => nodes.push(node("Identity", &["scores"], "output", vec![])),
            Head::Quarter => {
                let attributes = vec![ints("kernel_shape", &[4, 4]), ints("strides", &[4, 4])];
                nodes.push(node("AveragePool", &["scores"], "output", attributes));
            }
            Head::Classes { keep_axis } => {
                let attributes = vec![int("axis", 1), int("keepdims", keep_axis.into())];
                nodes.push(node("ArgMax", &["scores"], "output", attributes));
            }
            Head::Shifted => {
                nodes.push(node("ArgMax", &["scores"], "best", vec![int("axis", 1), int("keepdims", 0)]));
                constants.push(TensorProto { int64_data: vec![6], ..tensor("six", &[], INT64) });
                nodes.push(node("Add", &["best", "six"], "output", vec![]));
            }
            Head::Vector => {
                nodes.push(node("GlobalAveragePool", &["scores"], "means", vec![]));
                nodes.push(node("Flatten", &["means"], "output", vec![]));
            }
            Head::Unknown => nodes.push(node("Segment", &["scores"], "output", vec![])),
            Head::Framed(frame) => {
                let (edge, inner) = (128, 128 - 2 * frame);
                let frame = |i: i64| {
                    let (class, x, y) = (i / (edge * edge), i % edge - frame, i / edge % edge - frame);
                    let outside = !(0..inner).contains(&x) || !(0..inner).contains(&y);
                    if class == 0 && outside { 1e4 } else { 0.0 }
                };
                let values = (0..classes * edge * edge).map(frame).collect();
                constants.push(floats("frame", &[1, classes, edge, edge], values));
                nodes.push(node("Add", &["scores", "frame"], "output", vec![]));
            }
            Head::Nan => {
                constants.push(floats("nan", &[], vec![f32::NAN]));
                nodes.push(node("Mul", &["scores", "nan"], "output", vec![]));
            }
        }
        let graph = GraphProto {
            node: nodes,
            name: "paints".into(),
            initializer: constants,
            input: (0..self.inputs).map(|i| value(&name(i), self.element, &self.input)).collect(),
            output: vec![ValueInfoProto { name: "output".into(), ..Default::default() }],
            ..Default::default()
        };
        let opset_import = vec![OperatorSetIdProto { domain: String::new(), version: 13 }];
        ModelProto { ir_version: 8, opset_import, graph: Some(graph), ..Default::default() }.encode_to_vec()
    }
}

fn node(operation: &str, inputs: &[&str], output: &str, attribute: Vec<AttributeProto>) -> NodeProto {
    NodeProto {
        input: inputs.iter().map(|name| (*name).to_owned()).collect(),
        output: vec![output.to_owned()],
        name: format!("{operation} to {output}"),
        op_type: operation.to_owned(),
        attribute,
        ..Default::default()
    }
}

fn int(name: &str, i: i64) -> AttributeProto {
    let kind = attribute_proto::AttributeType::Int as i32;
    AttributeProto { name: name.to_owned(), r#type: kind, i, ..Default::default() }
}

fn ints(name: &str, ints: &[i64]) -> AttributeProto {
    let kind = attribute_proto::AttributeType::Ints as i32;
    AttributeProto { name: name.to_owned(), r#type: kind, ints: ints.to_vec(), ..Default::default() }
}

fn tensor(name: &str, dims: &[i64], data_type: i32) -> TensorProto {
    TensorProto { name: name.to_owned(), dims: dims.to_vec(), data_type, ..Default::default() }
}

fn floats(name: &str, dims: &[i64], float_data: Vec<f32>) -> TensorProto {
    TensorProto { float_data, ..tensor(name, dims, FLOAT) }
}

fn value(name: &str, elem_type: i32, axes: &[Axis]) -> ValueInfoProto {
    let dimension = |axis: &Axis| Dimension {
        value: Some(match axis {
            Axis::Fixed(size) => dimension::Value::DimValue(*size),
            Axis::Free(symbol) => dimension::Value::DimParam((*symbol).to_owned()),
        }),
        ..Default::default()
    };
    let shape = Some(TensorShapeProto { dim: axes.iter().map(dimension).collect() });
    let tensor = type_proto::Value::TensorType(type_proto::Tensor { elem_type, shape });
    ValueInfoProto {
        name: name.to_owned(),
        r#type: Some(TypeProto { value: Some(tensor), ..Default::default() }),
        ..Default::default()
    }
}
