//! A scene lit by its lightmap alone: what `texir bake scene.glb --profile bevy -o out/map.ktx2` made, drawn by Bevy
//! into a PNG.
//!
//! ```sh
//! cargo run -- out/map.glb out/map.ktx2 picture.png 2,1.6,3 0,1,0 9.7
//! ```
//!
//! The last three are where the camera is, what it looks at (metres, +Y up), and its exposure in EV100: 9.7 is a lit
//! room in nits; -0.26 shows a radiance of 1 as it is, for scenes of no particular unit.

use std::time::Duration;

use bevy::app::ScheduleRunnerPlugin;
use bevy::asset::UnapprovedPathMode;
use bevy::camera::{Exposure, RenderTarget};
use bevy::pbr::Lightmap;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::render_resource::TextureFormat;
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured, save_to_disk};
use bevy::window::ExitCondition;

/// Size of the picture, pixels.
const SIZE: [u32; 2] = [1280, 720];
/// Frames between the last asset and the picture: what is uploaded in one frame is drawn in a later one.
const FRAMES: u32 = 10;

/// What the command line asks for.
#[derive(Resource)]
struct Asked {
    scene: String,
    map: String,
    picture: String,
    eye: Vec3,
    target: Vec3,
    ev100: f32,
}

/// What the picture takes.
#[derive(Resource)]
struct Stage {
    scene: Handle<WorldAsset>,
    map: Handle<Image>,
    canvas: Handle<Image>,
    frames: u32,
}

fn main() -> AppExit {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let Some(asked) = parse(&args) else {
        eprintln!("usage: texir-bevy MAP.glb MAP.ktx2 PICTURE.png X,Y,Z X,Y,Z EV100");
        return AppExit::error();
    };
    App::new()
        .add_plugins(
            DefaultPlugins
                .set(AssetPlugin {
                    file_path: String::new(),
                    unapproved_path_mode: UnapprovedPathMode::Allow,
                    ..default()
                })
                .set(WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() })
                .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() }),
        )
        .add_plugins(ScheduleRunnerPlugin::run_loop(Duration::ZERO))
        .insert_resource(GlobalAmbientLight::NONE)
        .insert_resource(asked)
        .add_systems(Startup, set_up)
        .add_systems(Update, (light, take).chain())
        .run()
}

fn parse(args: &[String]) -> Option<Asked> {
    let [scene, map, picture, eye, target, ev100] = args else { return None };
    let point = |text: &str| {
        let numbers: Vec<f32> = text.split(',').map(str::parse).collect::<Result<_, _>>().ok()?;
        Some(Vec3::from(<[f32; 3]>::try_from(numbers).ok()?))
    };
    let absolute = |path: &str| Some(std::path::absolute(path).ok()?.to_str()?.to_owned());
    Some(Asked {
        scene: absolute(scene)?,
        map: absolute(map)?,
        picture: picture.clone(),
        eye: point(eye)?,
        target: point(target)?,
        ev100: ev100.parse().ok()?,
    })
}

fn set_up(mut commands: Commands, asked: Res<Asked>, assets: Res<AssetServer>, mut images: ResMut<Assets<Image>>) {
    let [width, height] = SIZE;
    let canvas = images.add(Image::new_target_texture(width, height, TextureFormat::Rgba8UnormSrgb, None));
    let scene = assets.load(GltfAssetLabel::Scene(0).from_asset(asked.scene.clone()));
    commands.spawn(WorldAssetRoot(scene.clone()));
    commands.spawn((
        Camera3d::default(),
        RenderTarget::Image(canvas.clone().into()),
        Exposure { ev100: asked.ev100 },
        Transform::from_translation(asked.eye).looking_at(asked.target, Vec3::Y),
    ));
    commands.insert_resource(Stage { scene, map: assets.load(asked.map.clone()), canvas, frames: 0 });
}

/// Every mesh of the scene takes its light from the map, which holds E/π in nits.
fn light(
    mut commands: Commands,
    stage: Res<Stage>,
    meshes: Query<(Entity, &MeshMaterial3d<StandardMaterial>), Added<Mesh3d>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    for (mesh, material) in &meshes {
        commands.entity(mesh).insert(Lightmap { image: stage.map.clone(), ..default() });
        if let Some(mut material) = materials.get_mut(&material.0) {
            material.lightmap_exposure = 1.0;
        }
    }
}

/// Takes the picture once all is there, and ends.
fn take(
    mut commands: Commands,
    asked: Res<Asked>,
    mut stage: ResMut<Stage>,
    assets: Res<AssetServer>,
    lit: Query<&Lightmap>,
    mut exit: MessageWriter<AppExit>,
) {
    for (path, failed) in [
        (&asked.scene, assets.load_state(&stage.scene).is_failed()),
        (&asked.map, assets.load_state(&stage.map).is_failed()),
    ] {
        if failed {
            error!("{path} cannot be loaded");
            exit.write(AppExit::error());
        }
    }
    let there = assets.is_loaded_with_dependencies(&stage.scene) && assets.is_loaded_with_dependencies(&stage.map);
    if !there || lit.is_empty() {
        return;
    }
    stage.frames += 1;
    if stage.frames == FRAMES {
        commands.spawn(Screenshot::image(stage.canvas.clone())).observe(save_to_disk(asked.picture.clone())).observe(
            |_: On<ScreenshotCaptured>, mut exit: MessageWriter<AppExit>| {
                exit.write(AppExit::Success);
            },
        );
    }
}
