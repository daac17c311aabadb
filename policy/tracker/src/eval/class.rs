//! Kinds of motion, by the names that the motion sets give their clips.

/// The kind of motion that a clip's name tells: its first word that is neither a number nor the
/// name of a set or an actor, up to the first digit. Names of numbers only (CMU's `02_03`) give
/// the first of them, the subject.
#[must_use]
pub fn motion_class(name: &str) -> String {
    let words: Vec<&str> = name.split('_').filter(|word| !word.is_empty()).collect();
    let named: Vec<&str> = words
        .iter()
        .copied()
        .filter(|word| !is_number(word))
        .collect();
    let kind = match named[..] {
        [] => return words.first().copied().unwrap_or("unnamed").to_owned(),
        [only] => only,
        [first, second, ..] if is_source(first) => second,
        [first, ..] => first,
    };
    let end = kind
        .find(|c: char| c.is_ascii_digit())
        .filter(|&end| end > 0);
    kind[..end.unwrap_or(kind.len())].to_owned()
}

fn is_number(word: &str) -> bool {
    word.bytes().all(|byte| byte.is_ascii_digit())
}

/// `dataset-1`, `woody2`: something numbered; `bd`: an actor's initials.
fn is_source(word: &str) -> bool {
    word.len() <= 2 || word.ends_with(|c: char| c.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sets_names_tell_their_kinds() {
        for (name, kind) in [
            (
                "dataset-2_raise-up-both-hands_active_008",
                "raise-up-both-hands",
            ),
            ("woody2_walk_fast_stright", "walk"),
            ("beatsaber_9", "beatsaber"),
            ("bd_kickLFront1Reps_001_120", "kickLFront"),
            ("bd_depositFloorR_001_120", "depositFloorR"),
            ("02_03", "02"),
            ("backflip", "backflip"),
            ("procedural-3", "procedural-"),
            ("", "unnamed"),
        ] {
            assert_eq!(motion_class(name), kind, "{name}");
        }
    }
}
