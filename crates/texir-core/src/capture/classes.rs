//! Semantic classes: what the ids and colours of semantic images stand for.

use std::collections::HashMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::atomic_file::write_atomic;
use crate::error::{Error, Result};
use crate::image_io::{read_colors, read_labels};
use crate::raster::{Labels, Raster};
use crate::text_file::read_text;

/// Lists that come along, by the names that captures call them.
///
/// - ADE20K, SceneParsing benchmark: 150 classes, numbered as in its annotations, in the colours of its `color150`, of
///   which road and skyscraper share one.
/// - COCO panoptic: 133 classes with the ids and colours of `panoptic_coco_categories.json`.
/// - NYU40: the 40 classes of Gupta et al. (CVPR 2013) in ScanNet's colours; ScanNet's benchmark takes 20 of them.
const SHIPPED: [(&str, &str); 3] = [
    ("ade20k", include_str!("classes/ade20k.json")),
    ("coco", include_str!("classes/coco.json")),
    ("nyu40", include_str!("classes/nyu40.json")),
];

/// At most this share of an image may have colours of no class: pixels that a resized image mixed at the borders of its
/// regions. They count as unknown.
const MIXED: f64 = 0.02;

/// What is drawn where no class is known, unless a class has this colour.
const BLACK: [u8; 3] = [0; 3];

/// One class.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Class {
    /// Its id; 0 is "unknown", whatever its name.
    pub id: u16,
    /// What people call it.
    pub name: String,
    /// Its colour in images, 8-bit RGB as stored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<[u8; 3]>,
}

/// A list of classes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Classes {
    /// As `classes` in `transforms.json` has it: a list that comes along, or a JSON file beside it.
    pub name: String,
    /// In the order of the list, which is that of a segmentation model's outputs.
    pub list: Vec<Class>,
}

impl Classes {
    /// The list of this name, or that of a JSON file in `folder`: `[{"id": 1, "name": "wall", "color": [120, 120,
    /// 120]}, …]`, where colours may be left out and other fields are not read.
    pub fn open(name: &str, folder: &Path) -> Result<Self> {
        let path = folder.join(name);
        let shipped = SHIPPED.iter().find(|(known, _)| *known == name);
        let text = match shipped {
            Some((_, text)) => (*text).to_owned(),
            None if path.is_file() => read_text(&path)?,
            None => {
                let known = SHIPPED.map(|(known, _)| known).join(", ");
                let what = format!("does not exist; expected a JSON file of classes, or one of the lists {known}");
                return Err(Error::file(path, what));
            }
        };
        let wrong = |e: serde_json::Error| {
            Error::file(&path, format!("is no list of classes ({e}); expected [{{\"id\": 1, \"name\": \"wall\"}}, …]"))
        };
        let list: Vec<Class> = serde_json::from_str(&text).map_err(wrong)?;
        let mut ids: Vec<u16> = list.iter().map(|class| class.id).collect();
        ids.sort_unstable();
        if let Some(twice) = ids.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(Error::file(&path, format!("id: {} is there twice; expected each class once", twice[0])));
        }
        Ok(Self { name: name.to_owned(), list })
    }

    /// The class of an id.
    pub fn of_id(&self, id: u16) -> Option<&Class> {
        self.list.iter().find(|class| class.id == id)
    }

    /// The ids of a semantic image. Where classes have colours, images in colour and palette images are read by their
    /// colours; other images hold the ids.
    pub fn read(&self, path: &Path) -> Result<Labels> {
        let colored = self.list.iter().any(|class| class.color.is_some());
        match read_colors(path).transpose().filter(|_| colored) {
            Some(colors) => self.of_colors(path, &colors?),
            None => read_labels(path),
        }
    }

    /// The first class of each pixel's colour.
    fn of_colors(&self, path: &Path, colors: &Raster<[u8; 3]>) -> Result<Labels> {
        let mut id_of = HashMap::from([(BLACK, 0)]);
        id_of.extend(self.list.iter().rev().filter_map(|class| Some((class.color?, class.id))));
        let labels = colors.map(|color| id_of.get(color).copied());
        let unknown = labels.data.iter().filter(|id| id.is_none()).count();
        if unknown as f64 > MIXED * labels.data.len() as f64 {
            let first = labels.data.iter().position(Option::is_none).unwrap_or_default();
            let (x, y) = (first % labels.width, first / labels.width);
            return Err(Error::file(
                path,
                format!(
                    "pixel ({x}, {y}) has the colour {:?} of no class in {}, as {unknown} of {} pixels do; expected at most \
                     {:.0} %: is it another list (`classes` in transforms.json)?",
                    colors.data[first],
                    self.name,
                    labels.data.len(),
                    100.0 * MIXED
                ),
            ));
        }
        Ok(labels.map(|id| id.unwrap_or(0)))
    }

    /// The same list for a capture in `folder`, into which a file of the user's own is copied.
    pub(super) fn bring(&self, folder: &Path) -> Result<Self> {
        if SHIPPED.iter().any(|(known, _)| *known == self.name) {
            return Ok(self.clone());
        }
        let name = "classes.json";
        write_atomic(folder.join(name), |sink| serde_json::to_writer_pretty(sink, &self.list))?;
        Ok(Self { name: name.to_owned(), list: self.list.clone() })
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use super::*;
    use crate::image_io::{write_png_labels, write_png_rgb};

    fn shipped(name: &str) -> Classes {
        Classes::open(name, Path::new("")).unwrap()
    }

    #[test]
    fn lists_that_come_along_are_those_of_the_data_sets() {
        for (name, number, id, class, color) in [
            ("ade20k", 150, 1, "wall", [120, 120, 120]),
            ("ade20k", 150, 4, "floor", [80, 50, 50]),
            ("ade20k", 150, 150, "flag", [92, 0, 255]),
            ("coco", 133, 1, "person", [220, 20, 60]),
            ("coco", 133, 118, "floor-wood", [218, 88, 184]),
            ("coco", 133, 200, "rug-merged", [250, 141, 255]),
            ("nyu40", 40, 1, "wall", [174, 199, 232]),
            ("nyu40", 40, 24, "refrigerator", [255, 127, 14]),
            ("nyu40", 40, 40, "otherprop", [100, 85, 144]),
        ] {
            let classes = shipped(name);
            assert_eq!(classes.list.len(), number, "{name}");
            let expected = Class { id, name: class.to_owned(), color: Some(color) };
            assert_eq!(classes.of_id(id), Some(&expected), "{name}");
        }
        for (name, _) in SHIPPED {
            let mut colors: Vec<_> = shipped(name).list.iter().map(|class| class.color.unwrap()).collect();
            colors.sort_unstable();
            let shared = colors.windows(2).filter(|pair| pair[0] == pair[1]).count();
            assert_eq!(shared, usize::from(name == "ade20k"), "{name}: ADE20K's road and skyscraper look alike");
        }
    }

    /// 10×10 pixels of ADE20K: half wall, a row unknown, the rest floor.
    fn picture(unlike: usize) -> Raster<[u8; 3]> {
        let color = |i: usize| match i {
            0..50 => [120, 120, 120],
            50..60 => [0; 3],
            _ if i >= 100 - unlike => [1, 2, 3],
            _ => [80, 50, 50],
        };
        Raster::new(10, 10, (0..100).map(color).collect()).unwrap()
    }

    #[test]
    fn colours_become_ids_and_grey_levels_stay() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.png");
        write_png_rgb(&path, &picture(2)).unwrap();
        let classes = shipped("ade20k");
        let expected = |i| [1, 0, 4, 0][usize::from(i >= 50) + usize::from(i >= 60) + usize::from(i >= 98)];
        assert_eq!(classes.read(&path).unwrap().data, (0..100).map(expected).collect::<Vec<u16>>());

        // A palette's colours count, not its order.
        let file = File::create(&path).unwrap();
        let mut encoder = png::Encoder::new(file, 2, 1);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_palette(vec![80, 50, 50, 120, 120, 120]);
        encoder.write_header().unwrap().write_image_data(&[0, 1]).unwrap();
        assert_eq!(classes.read(&path).unwrap().data, [4, 1]);
        assert_eq!(read_labels(&path).unwrap().data, [0, 1]);

        write_png_labels(&path, &Labels::filled(3, 2, 37)).unwrap();
        assert_eq!(classes.read(&path).unwrap(), Labels::filled(3, 2, 37));
    }

    #[test]
    fn colours_of_no_class_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.png");
        write_png_rgb(&path, &picture(3)).unwrap();
        let error = shipped("ade20k").read(&path).unwrap_err().to_string();
        for part in ["view.png", "pixel (7, 9)", "[1, 2, 3]", "ade20k", "3 of 100", "2 %"] {
            assert!(error.contains(part), "{part:?} is not in: {error}");
        }
        let error = read_labels(&path).unwrap_err().to_string();
        assert!(error.contains("\"classes\" in transforms.json"), "{error}");
    }

    #[test]
    fn lists_of_ones_own_are_checked() {
        let folder = tempfile::tempdir().unwrap();
        let open = |text: &str| {
            std::fs::write(folder.path().join("mine.json"), text).unwrap();
            Classes::open("mine.json", folder.path())
        };
        let mine = open(r#"[{"id": 2, "name": "rug", "isthing": 0}, {"id": 1, "name": "lamp", "color": [9, 8, 7]}]"#);
        assert_eq!(mine.unwrap().list.iter().map(|class| class.id).collect::<Vec<_>>(), [2, 1]);
        for (text, says) in [
            (r#"[{"id": 2, "name": "a"}, {"id": 2, "name": "b"}]"#, "id: 2 is there twice"),
            (r#"[{"id": 2}]"#, "missing field `name`"),
            (r#"[{"id": 2, "name": "a", "color": [1, 2, 256]}]"#, "256"),
            ("{", "no list of classes"),
        ] {
            let error = open(text).unwrap_err().to_string();
            assert!(error.contains("mine.json") && error.contains(says), "{error}");
        }
        let error = Classes::open("ade", folder.path()).unwrap_err().to_string();
        assert!(error.contains("ade20k, coco, nyu40") && error.contains("does not exist"), "{error}");
    }
}
