//! Tests the instructions of docs/ADDING.md for recipes: any type that implements `Recipe` can be trained.

mod common;

use common::folder;
use indicatif::ProgressBar;
use models::card::Scaling;
use models::dataset::{Dataset, Item};
use models::train::{
    Beside, Calibration, Fitted, Job, Learnt, PAPER, Plan, Recipe, Row, TrainError, Windows, scaling, train,
};
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::Model;

/// A custom recipe in forty lines, which uses the paper's windows with the same scale for all channels.
#[derive(Debug)]
struct Plain;

impl Recipe for Plain {
    fn name(&self) -> &'static str {
        "plain"
    }

    fn about(&self) -> &'static str {
        "Features as they are, all by one scale"
    }

    fn features(&self) -> FeatureKind {
        FeatureKind::Raw
    }

    fn plan(&self) -> Plan {
        Plan { epochs: 8, ..PAPER.plan() }
    }

    fn windows(&self, item: &Item, label: usize, place: usize, seed: u64) -> Windows {
        PAPER.windows(item, label, place, seed)
    }

    fn beside(&self, _: usize, _: &[String]) -> Beside {
        Beside { words: "nothing is varied".to_owned(), ..Beside::default() }
    }

    fn scaling(&self, learnt: &[Row<'_>], real: &mut dyn Iterator<Item = &[f32]>) -> Scaling {
        scaling(learnt, |_, _| 10.0, real, 1.0..=20.0)
    }

    fn fit(&self, learnt: &Learnt<'_>, seed: u64, progress: &ProgressBar) -> Result<Fitted, TrainError> {
        PAPER.fit(learnt, seed, progress)
    }

    fn calibration(&self) -> Calibration {
        Calibration::Real
    }

    fn shortened(&self, _: Option<usize>) -> Box<dyn Recipe> {
        Box::new(Self)
    }

    fn for_simulated(&self) -> Box<dyn Recipe> {
        Box::new(Self)
    }
}

#[test]
fn a_recipe_of_ones_own_trains_as_the_others_do() {
    let data = folder();
    let recordings = Dataset::read_where(data.path(), None, |_, _| true).unwrap();
    let job = Job {
        name: "mine".to_owned(),
        about: "a test".to_owned(),
        seed: 1,
        excluded: Vec::new(),
        progress: false,
    };
    let model = train(&recordings, &[], &Plain, &job).unwrap();
    assert_eq!((model.card.training.recipe.as_str(), model.card.features.as_str()), ("plain", "raw"));
    assert_eq!(model.card.training.augmentation, "nothing is varied");
    assert!(model.card.scaling.deviation.iter().all(|divisor| *divisor == 10.0), "its own scaling");
    assert!(model.memory.is_none(), "it cannot adapt");
    let blob = model.blob().unwrap();
    assert_eq!(Model::parse(&blob).unwrap().info().label_count, recordings.labels.len());
}
