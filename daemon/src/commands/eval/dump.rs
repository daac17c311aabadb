//! The predicted and the true motion of every clip, as numpy arrays.

use std::{fs::File, io, path::Path};

use npyz::{WriterBuilder as _, npz::NpzWriter};
use posed_body::JOINTS;
use posed_tracker::{
    eval::{ClipResult, Dump},
    metrics::Track,
};

/// Writes for each clip `<number>_<name>/{predicted,true}_{joints,rotations}`: joints are (frames,
/// 22, 3) in metres, rotations (frames, 22, 4) local quaternions x, y, z, w; posed's world. And
/// `<number>_<name>/contacts`, (frames, 2): what the tracker says of how likely the left and the
/// right foot stand, NaN where it does not.
///
/// # Errors
/// The file cannot be written.
pub(super) fn write(path: &Path, results: &[ClipResult]) -> io::Result<()> {
    let mut archive = NpzWriter::create(path)?;
    for (number, result) in results.iter().enumerate() {
        let Some(dump) = &result.dump else { continue };
        let folder = format!("{number:04}_{}", file_name(&result.name));
        both(&mut archive, &folder, dump)?;
    }
    Ok(())
}

type Archive = NpzWriter<io::BufWriter<File>>;

fn both(archive: &mut Archive, folder: &str, dump: &Dump) -> io::Result<()> {
    for (kind, track) in [("predicted", &dump.predicted), ("true", &dump.truth)] {
        joints(archive, &format!("{folder}/{kind}_joints"), track)?;
        rotations(archive, &format!("{folder}/{kind}_rotations"), track)?;
    }
    let said = |contacts: &Option<[f32; 2]>| contacts.unwrap_or([f32::NAN; 2]);
    let contacts = dump.contacts.iter().flat_map(said);
    let shape = [dump.contacts.len(), 2];
    array(archive, &format!("{folder}/contacts"), &shape, contacts)
}

fn joints(archive: &mut Archive, name: &str, track: &Track) -> io::Result<()> {
    let numbers = track
        .positions
        .iter()
        .flatten()
        .flat_map(|position| position.to_array());
    array(archive, name, &[track.len(), JOINTS, 3], numbers)
}

fn rotations(archive: &mut Archive, name: &str, track: &Track) -> io::Result<()> {
    let numbers = track
        .local
        .iter()
        .flatten()
        .flat_map(|turn| turn.to_array());
    array(archive, name, &[track.len(), JOINTS, 4], numbers)
}

fn array(
    archive: &mut Archive,
    name: &str,
    shape: &[usize],
    numbers: impl Iterator<Item = f32>,
) -> io::Result<()> {
    let shape: Vec<u64> = shape.iter().map(|&size| size as u64).collect();
    let mut writer = archive
        .array(name, npyz::zip::write::FileOptions::default())?
        .default_dtype()
        .shape(&shape)
        .begin_nd()?;
    writer.extend(numbers)?;
    writer.finish()
}

/// Names of clips may hold anything; names in the archive are kept plain.
fn file_name(name: &str) -> String {
    let plain = |c: char| {
        if c.is_ascii_alphanumeric() || c == '-' {
            c
        } else {
            '_'
        }
    };
    name.chars().map(plain).collect()
}
