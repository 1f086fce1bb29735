//! A module's parameters by name: `encoder.0.qkv`, `decoder.3.fc1`, …

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param, ParamId};
use burn::tensor::{Tensor, TensorData};

/// A parameter's name, shape and values.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedTensor {
    /// Path of field names, joined by dots.
    pub name: String,
    /// Shape; empty for a scalar.
    pub shape: Vec<usize>,
    /// Values, row-major.
    pub values: Vec<f32>,
}

/// Which parameter it is, without its values.
#[derive(Clone, Debug, PartialEq)]
pub struct ParamInfo {
    /// Burn's number for it, by which optimisers know it.
    pub id: ParamId,
    /// As [`NamedTensor::name`].
    pub name: String,
    /// As [`NamedTensor::shape`].
    pub shape: Vec<usize>,
}

/// A parameter whose values are copied out when asked for.
pub struct LazyParam<'a> {
    /// As [`NamedTensor::name`].
    pub name: String,
    /// As [`NamedTensor::shape`].
    pub shape: Vec<usize>,
    /// Its values, row-major.
    pub read: Box<dyn Fn() -> Vec<f32> + 'a>,
}

impl<'a> From<&'a NamedTensor> for LazyParam<'a> {
    fn from(tensor: &'a NamedTensor) -> Self {
        Self {
            name: tensor.name.clone(),
            shape: tensor.shape.clone(),
            read: Box::new(|| tensor.values.clone()),
        }
    }
}

/// Copies out all parameters, in the module's order.
#[must_use]
pub fn export<M: Module>(module: &M) -> Vec<NamedTensor> {
    let copied = lazy(module).into_iter().map(|param| NamedTensor {
        values: (param.read)(),
        name: param.name,
        shape: param.shape,
    });
    copied.collect()
}

/// All parameters, in the module's order.
#[must_use]
pub fn list<M: Module>(module: &M) -> Vec<ParamInfo> {
    visit(module).into_iter().map(|(info, _)| info).collect()
}

/// All parameters, in the module's order; the handles share the module's tensors.
#[must_use]
pub fn lazy<M: Module>(module: &M) -> Vec<LazyParam<'static>> {
    let params = visit(module).into_iter();
    let params =
        params.map(|(ParamInfo { name, shape, .. }, read)| LazyParam { name, shape, read });
    params.collect()
}

/// Copies a parameter's values out.
type Read = Box<dyn Fn() -> Vec<f32>>;

fn visit<M: Module>(module: &M) -> Vec<(ParamInfo, Read)> {
    struct Visit(Vec<String>, Vec<(ParamInfo, Read)>);
    impl ModuleVisitor for Visit {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.0.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.0.pop();
        }
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let tensor = param.val();
            let info = ParamInfo {
                id: param.id,
                name: self.0.join("."),
                shape: tensor.dims().to_vec(),
            };
            self.1
                .push((info, Box::new(move || to_vec(tensor.clone()))));
        }
    }
    let mut visitor = Visit(Vec::new(), Vec::new());
    module.visit(&mut visitor);
    visitor.1
}

/// New values for the parameter with a name and shape; `None` keeps the old ones.
type Values<'a> = dyn FnMut(&str, &[usize]) -> Option<Vec<f32>> + 'a;

/// Replaces the parameters for which `value` has new ones.
pub fn replace<M: Module>(module: M, value: &mut Values) -> M {
    struct Replace<'a>(Vec<String>, &'a mut Values<'a>);
    impl ModuleMapper for Replace<'_> {
        fn enter_module(&mut self, name: &str, _: &str) {
            self.0.push(name.to_owned());
        }
        fn exit_module(&mut self, _: &str, _: &str) {
            self.0.pop();
        }
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            let shape = param.val().dims();
            match (self.1)(&self.0.join("."), &shape) {
                None => param,
                Some(values) => param.map(|old| {
                    let tracked = old.is_require_grad();
                    let new = Tensor::from_data(TensorData::new(values, shape), &old.device());
                    if tracked { new.require_grad() } else { new }
                }),
            }
        }
    }
    module.map(&mut Replace(Vec::new(), value))
}

/// A tensor's values as f32.
#[must_use]
pub fn to_vec<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    let data = tensor.into_data().convert::<f32>();
    data.iter::<f32>().collect()
}
