//! x
use lumi_data::store::{ObjectRecord, list};
use std::collections::BTreeMap;
use std::path::Path;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let mut all: BTreeMap<&str, Vec<(f64, String)>> = BTreeMap::new();
    for p in list(Path::new(&a[1])).unwrap() {
        let x = ObjectRecord::read(&p).unwrap();
        let y = ObjectRecord::read(&Path::new(&a[2]).join(p.file_name().unwrap())).unwrap();
        for l in 0..x.lights.len() {
            let (mut s, mut n) = (0.0, 0.0);
            for v in 0..x.cameras.len() {
                let (i, j) = (
                    x.compose(v, &[(l, [1.0; 3])]).to_display(),
                    y.compose(v, &[(l, [1.0; 3])]).to_display(),
                );
                for (k, (p, q)) in i.pixels.iter().zip(&j.pixels).enumerate() {
                    if j.alpha.as_ref().unwrap()[k] > 0.99 {
                        for c in 0..3 {
                            s += f64::from(p[c] - q[c]).powi(2);
                            n += 1.0;
                        }
                    }
                }
            }
            all.entry(x.lights[l].light.kind()).or_default().push((
                -10.0 * (s / n + 1e-9_f64).log10(),
                format!("{} {}", x.name, x.lights[l].name),
            ));
        }
    }
    for (k, mut v) in all {
        v.sort_by(|a, b| a.0.total_cmp(&b.0));
        println!(
            "{k}: mean {:.1} median {:.1} worst {:?}",
            v.iter().map(|x| x.0).sum::<f64>() / v.len() as f64,
            v[v.len() / 2].0,
            &v[..3.min(v.len())]
        );
    }
}
