//! From views to their semantic images.

use std::path::Path;
use std::sync::Arc;

use glam::Vec2;
use rayon::prelude::*;

use super::crop::{at_origin, crops, cut, expose, weight};
use super::network::Network;
use super::votes::winner;
use crate::capture::{Classes, View};
use crate::error::Result;
use crate::image_io::write_png_labels;
use crate::progress::{Progress, Task};
use crate::raster::{Labels, Raster};

/// A segmentation model with the classes that it tells apart.
#[derive(Clone, Debug)]
pub struct Segmenter {
    network: Arc<Network>,
    classes: Arc<Classes>,
}

impl Segmenter {
    /// Opens a model and the list of its classes, in the order of its outputs: one that comes along by its name, or a
    /// JSON file ([`Classes::open`]). The model is tried on a grey image.
    pub fn open(model: impl AsRef<Path>, classes: &str) -> Result<Self> {
        let classes = Classes::open(classes, Path::new(""))?;
        let network = Network::open(model.as_ref(), classes.list.len())?;
        Ok(Self { network: Arc::new(network), classes: Arc::new(classes) })
    }

    /// Gives each view the ids that the model finds, in `semantic/` of the capture's folder.
    pub fn label(&self, views: &mut [View], folder: &Path, progress: &dyn Progress) -> Result<()> {
        let of = |view: &View| crops(&view.camera, self.network.input).len();
        let total: usize = views.iter().map(of).sum();
        let _task = Task::start(progress, "import: segmentation", total as u64, "crops");
        // A run takes a thread and the memory of its activations: no more runs at a time than there are threads.
        let most = views.iter().map(of).max().unwrap_or(1);
        for views in views.chunks_mut((rayon::current_num_threads() / most).max(1)) {
            views.par_iter_mut().try_for_each(|view| {
                let path = folder.join("semantic").join(format!("{}.png", view.name));
                write_png_labels(&path, &self.ids(view, progress)?)?;
                view.semantic = Some(path);
                view.classes = Some(self.classes.clone());
                Ok(())
            })?;
        }
        Ok(())
    }

    /// The ids of a view's pixels.
    fn ids(&self, view: &View, progress: &dyn Progress) -> Result<Labels> {
        progress.check()?;
        let image = view.load_picture(progress)?;
        let camera = at_origin(&view.camera);
        let crops = crops(&camera, self.network.input);
        let seen: Vec<_> = crops.par_iter().map(|crop| cut(&image, &camera, crop)).collect();
        drop(image);
        let run = |picture: &Raster<[u8; 3]>| {
            progress.check()?;
            let votes = self.network.run(picture)?;
            progress.advance(1);
            Ok(votes)
        };
        let votes = expose(&seen).par_iter().map(run).collect::<Result<Vec<_>>>()?;
        let list = &self.classes.list;
        let id = |sums: &mut Vec<f32>, pixel: usize| {
            sums.fill(0.0);
            let (x, y) = ((pixel % camera.width) as f32, (pixel / camera.width) as f32);
            let direction = camera.direction(x + 0.5, y + 0.5);
            for (crop, votes) in crops.iter().zip(&votes) {
                if let Some(place) = crop.project(direction) {
                    let at = place / Vec2::new(crop.width as f32, crop.height as f32);
                    votes.add(at, weight(at), sums);
                }
            }
            winner(sums).map_or(0, |class| list[class].id)
        };
        let ids = (0..camera.pixels()).into_par_iter().map_init(|| vec![0.0; list.len()], id).collect();
        Labels::new(camera.width, camera.height, ids)
    }
}
