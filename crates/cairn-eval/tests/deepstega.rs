//! DeepStega on the made-up landmark: what is hidden is revealed from the marked
//! photograph, out of the photograph and not by heart, and the same bytes come from
//! the same seed.

use cairn_eval::baseline::deepstega::{DeepConfig, DeepStega, DeepTrainer};
use cairn_landmark::{Landmark, LandmarkConfig};
use cairn_mark::emblem;
use cairn_scene::Picture;
use cairn_scene::metrics::{psnr_db, ssim};

/// Side of the hidden picture, px.
const HIDDEN: usize = 32;

/// Five photographs to train on and one that nobody saw.
fn photographs() -> (Vec<Picture>, Picture) {
    let config = LandmarkConfig { contributors: 2, photographs: 3, ..LandmarkConfig::default() };
    let views = Landmark::generate(&config, 4).unwrap().views;
    let mut pictures: Vec<Picture> = views.into_iter().map(|view| view.picture).collect();
    let unseen = pictures.remove(4);
    (pictures, unseen)
}

fn trained(steps: u64, channels: usize) -> DeepStega {
    let config = DeepConfig { steps, channels, batch: 2, learning_rate: 6e-3, ..DeepConfig::default() };
    let mut trainer = DeepTrainer::new(photographs().0, &[emblem(0, HIDDEN, 1)], config, 3).unwrap();
    while trainer.steps_done() < trainer.steps_total() {
        trainer.step().unwrap();
    }
    trainer.finish()
}

#[test]
fn what_is_hidden_is_revealed_from_the_photograph_and_from_nowhere_else() {
    let (_, photograph) = photographs();
    let stega = trained(1200, 12);
    // One that training hid in other photographs, and one that it never saw.
    for (index, least) in [(0, 0.9), (2, 0.7)] {
        let hidden = emblem(index, HIDDEN, 1);
        let marked = stega.hide(&photograph, &hidden).unwrap();
        let kept = psnr_db(&photograph, &marked).unwrap();
        let found = ssim(&hidden, &stega.reveal(&marked, [HIDDEN; 2]).unwrap()).unwrap();
        let nothing = ssim(&hidden, &stega.reveal(&photograph, [HIDDEN; 2]).unwrap()).unwrap();
        assert!(kept > 30.0, "emblem {index}: the photograph is kept by {kept:.1} dB only");
        assert!(found > least, "emblem {index}: revealed with an SSIM of {found:.3}");
        assert!(nothing < 0.2, "emblem {index}: revealed with an SSIM of {nothing:.3} where it is not");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes_and_they_come_back() {
    let (_, photograph) = photographs();
    let hidden = emblem(1, HIDDEN, 1);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| trained(4, 6).to_bytes().unwrap())
    };
    let bytes = with(1);
    assert!(bytes == with(3), "one thread and three differ");
    let (stega, again) = (trained(4, 6), DeepStega::from_bytes(&bytes).unwrap());
    assert_eq!(again.to_bytes().unwrap(), bytes);
    assert_eq!(again.hide(&photograph, &hidden).unwrap(), stega.hide(&photograph, &hidden).unwrap());
}

#[test]
fn what_cannot_be_trained_on_is_refused_with_a_remedy() {
    let (photographs, _) = photographs();
    let hidden = [emblem(0, HIDDEN, 1)];
    let start = |photographs: Vec<Picture>, hidden: &[Picture], config| {
        DeepTrainer::new(photographs, hidden, config, 1).err().unwrap()
    };
    let large = DeepConfig { patch_px: 100, ..DeepConfig::default() };
    assert!(start(photographs.clone(), &hidden, large).to_string().contains("96 x 128 px has no patch of 100 px"));
    assert!(start(Vec::new(), &hidden, DeepConfig::default()).to_string().contains("bring both"));
    assert!(start(photographs.clone(), &[], DeepConfig::default()).to_string().contains("bring both"));
    let none = DeepConfig { steps: 0, ..DeepConfig::default() };
    assert!(start(photographs, &hidden, none).to_string().contains("deepstega.steps is 0"));
}
