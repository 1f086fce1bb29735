//! Devices by their names on the command line.

use burn::tensor::Device;
use std::fmt;
use std::str::FromStr;

/// `--device` of the commands that run the model.
#[derive(clap::Args)]
pub struct OnDevice {
    /// Where to compute: cpu, or a GPU that the program is built for, as vulkan or vulkan:1
    #[arg(long, default_value = "cpu")]
    pub device: DeviceName,
}

/// Where to compute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceName {
    name: &'static str,
    api: Api,
    /// Which of this machine's devices; the system's choice without a number.
    number: Option<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Api {
    /// Burn's Flex with our own kernels.
    Cpu,
    #[cfg(feature = "vulkan")]
    Vulkan,
    #[cfg(feature = "metal")]
    Metal,
    #[cfg(feature = "cuda")]
    Cuda,
    #[cfg(feature = "rocm")]
    Rocm,
}

/// What this program is built for.
const APIS: &[(&str, Api)] = &[
    ("cpu", Api::Cpu),
    #[cfg(feature = "vulkan")]
    ("vulkan", Api::Vulkan),
    #[cfg(feature = "metal")]
    ("metal", Api::Metal),
    #[cfg(feature = "cuda")]
    ("cuda", Api::Cuda),
    #[cfg(feature = "rocm")]
    ("rocm", Api::Rocm),
];

/// Features of the program that bring a device of the same name.
const FEATURES: [&str; 4] = ["vulkan", "metal", "cuda", "rocm"];

impl DeviceName {
    /// Whether it is the CPU.
    #[must_use]
    pub fn is_cpu(&self) -> bool {
        self.api == Api::Cpu
    }

    /// The device; a GPU is opened by the first tensor on it.
    #[must_use]
    pub fn open(&self) -> Device {
        #[cfg(any(feature = "vulkan", feature = "metal"))]
        let kind = match self.number {
            Some(number) => burn::tensor::DeviceKind::DiscreteGpu(number),
            None => burn::tensor::DeviceKind::DefaultDevice,
        };
        match self.api {
            Api::Cpu => Device::flex(),
            #[cfg(feature = "vulkan")]
            Api::Vulkan => Device::vulkan(kind),
            #[cfg(feature = "metal")]
            Api::Metal => Device::metal(kind),
            #[cfg(feature = "cuda")]
            Api::Cuda => Device::cuda(self.number.unwrap_or(0)),
            #[cfg(feature = "rocm")]
            Api::Rocm => Device::rocm(self.number.unwrap_or(0)),
        }
    }
}

impl Default for DeviceName {
    /// The CPU.
    fn default() -> Self {
        let (name, api) = APIS[0];
        Self {
            name,
            api,
            number: None,
        }
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name)?;
        self.number.map_or(Ok(()), |number| write!(f, ":{number}"))
    }
}

impl FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, number) = match text.split_once(':') {
            Some((name, number)) => (name, Some(number)),
            None => (text, None),
        };
        let Some(&(name, api)) = APIS.iter().find(|(known, _)| *known == name) else {
            let known: Vec<_> = APIS.iter().map(|(known, _)| *known).collect();
            let known = known.join(", ");
            return Err(if FEATURES.contains(&name) {
                format!(
                    "this program is built for {known}; `--features {name}` builds it for {name}"
                )
            } else {
                format!("expected one of {known}")
            });
        };
        if number.is_some() && api == Api::Cpu {
            return Err("cpu takes no number".into());
        }
        let number = number.map(str::parse).transpose();
        let number =
            number.map_err(|_| format!("expected {name}:N with the number of a device, from 0"))?;
        Ok(Self { name, api, number })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_printed() {
        let read = |text: &str| text.parse::<DeviceName>();
        let printed = |text: &str| read(text).map(|device| device.to_string());
        let fails = |text: &str, part: &str| {
            let error = read(text).expect_err(text);
            assert!(error.contains(part), "{error} without {part}");
        };
        for (name, _) in APIS {
            assert_eq!(printed(name).as_deref(), Ok(*name));
        }
        fails("abacus", "expected one of cpu");
        fails("cpu:0", "no number");
        for feature in FEATURES {
            let second = format!("{feature}:1");
            if APIS.iter().any(|(name, _)| *name == feature) {
                assert_eq!(printed(&second).as_ref(), Ok(&second));
                fails(&format!("{feature}:x"), "number of a device");
            } else {
                fails(&second, "--features");
            }
        }
    }
}
