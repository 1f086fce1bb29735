//! Trains from a config without the CLI.
use lumi_core::{Event, Progress};
struct Lines;
impl Progress for Lines {
    fn event(&self, event: Event) {
        match event {
            Event::Step { done, note } if done % 20 == 0 && !note.is_empty() => {
                println!("{done} {note}")
            }
            Event::Begin { stage, total } => println!("== {stage} ({total})"),
            _ => {}
        }
    }
}
fn main() {
    let path = std::env::args().nth(1).expect("config");
    let config = lumi_train::TrainConfig::read(path.as_ref()).expect("config");
    let out = lumi_train::train(
        &config,
        std::env::args().any(|a| a == "--resume"),
        &[burn::tensor::Device::flex()],
        &lumi_train::reduce::Solo,
        &Lines,
    );
    println!("{:?}", out.map_err(|e| e.to_string()));
}
