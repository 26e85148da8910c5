//! Where fuzzing begins: `CAIRN_FUZZ_SEEDS=DIR` has a target write input that its readers take into `DIR`, one file each,
//! before it reads its corpora. From nothing libFuzzer does not find a signed note in a day.

use std::{env, fs, path::Path};

/// Writes the inputs, each behind the byte that chooses its reader.
pub fn write<'a>(good: impl Iterator<Item = (&'a str, Vec<Vec<u8>>)>) {
    let Some(folder) = env::var_os("CAIRN_FUZZ_SEEDS") else { return };
    let folder = Path::new(&folder);
    fs::create_dir_all(folder).expect("the seeds' folder cannot be made");
    for (which, (name, inputs)) in good.enumerate() {
        let which = u8::try_from(which).expect("one byte chooses the reader");
        for (number, input) in inputs.into_iter().enumerate() {
            let file = folder.join(format!("{}-{number}", name.replace(['/', ' '], "-")));
            fs::write(file, [&[which], input.as_slice()].concat()).expect("a seed cannot be written");
        }
    }
}
