//! Base stations: where they stand and how their light planes are shaped; read from the file in
//! which libsurvive keeps them.

use glam::{DQuat, DVec3};

use super::{gen1, reproject, reproject::PlaneCalibration};

/// Generations of base stations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Generation {
    /// Two rotors and a flash for all sensors, 2016.
    One,
    /// One rotor with two tilted planes, which carry data, 2018.
    Two,
}

/// What tells a base station's light from the others'.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Source {
    /// Generation 1: whether it flashes first or second, 0 or 1.
    Slot(u8),
    /// Generation 2: the channel that it is set to, 0 to 15.
    Channel(u8),
}

impl Source {
    /// Sources that there can be.
    pub const COUNT: usize = 18;

    /// Its generation.
    #[must_use]
    pub fn generation(self) -> Generation {
        match self {
            Self::Slot(_) => Generation::One,
            Self::Channel(_) => Generation::Two,
        }
    }

    /// The source of a number that [`Source::index`] gives.
    #[must_use]
    pub fn from_index(index: usize) -> Option<Self> {
        match u8::try_from(index) {
            Ok(channel @ 0..16) => Some(Self::Channel(channel)),
            Ok(16) => Some(Self::Slot(0)),
            Ok(17) => Some(Self::Slot(1)),
            _ => None,
        }
    }

    /// A number of its own below [`Source::COUNT`].
    #[must_use]
    pub fn index(self) -> usize {
        match self {
            Self::Slot(slot) => 16 + usize::from(slot & 1),
            Self::Channel(channel) => usize::from(channel & 15),
        }
    }
}

impl std::fmt::Display for Source {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Slot(slot) => write!(f, "slot {slot}"),
            Self::Channel(channel) => write!(f, "channel {channel}"),
        }
    }
}

/// A base station.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaseStation {
    /// What its light is told by.
    pub source: Source,
    /// Its serial number, as it broadcasts it.
    pub id: u32,
    /// Where it stands in posed's world, metres.
    pub position: DVec3,
    /// Base station's frame (looks along -Z, Y up, X right) to posed's world.
    pub rotation: DQuat,
    /// Shape of its two light planes.
    pub calibration: [PlaneCalibration; 2],
}

impl BaseStation {
    /// A point of the world in the base station's frame.
    #[must_use]
    pub fn to_local(&self, point_in_world: DVec3) -> DVec3 {
        self.rotation.conjugate() * (point_in_world - self.position)
    }

    /// The angle at which one of its planes (0 or 1) passes a point of its own frame, rad, and
    /// that angle's gradient over the point, rad/m.
    #[must_use]
    pub fn reading(&self, plane: usize, point_in_base: DVec3) -> (f64, DVec3) {
        let calibration = &self.calibration[plane & 1];
        match self.source.generation() {
            Generation::One => gen1::reproject(calibration, plane, point_in_base),
            Generation::Two => {
                reproject::reproject_with_gradient(calibration, plane, point_in_base)
            }
        }
    }

    /// The direction, in its own frame, in which readings of both its planes meet, as if the planes
    /// were flat; unit.
    #[must_use]
    pub fn bearing(&self, angles: [f64; 2]) -> DVec3 {
        match self.source.generation() {
            Generation::One => gen1::bearing(&self.calibration, angles),
            Generation::Two => reproject::bearing(&self.calibration, angles),
        }
    }
}

/// Why a base-station file cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BaseStationError {
    /// The text is not libsurvive's JSON.
    #[error("base-station file, line {line}: {what}")]
    Syntax {
        /// Line, from 1.
        line: usize,
        /// What is wrong there.
        what: &'static str,
    },
    /// An entry lacks what a base station needs.
    #[error("base-station file, {entry}: {what}")]
    Entry {
        /// Name of the entry, for example `lighthouse0`.
        entry: String,
        /// What is wrong with it.
        what: &'static str,
    },
    /// Two entries have one channel.
    #[error(
        "base-station file: two base stations are set to {0}; set one of them to another \
         channel, or take its entry out if it is gone"
    )]
    SharedChannel(Source),
    /// No entry describes a base station whose position is known.
    #[error(
        "base-station file: no entry has its position and calibration set; \
         let libsurvive calibrate first"
    )]
    Empty,
}

/// Turns libsurvive's world (Z up) into posed's (Y up): (x, y, z) becomes (x, z, -y).
#[must_use]
pub fn from_z_up() -> DQuat {
    DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2)
}

/// How a station of generation 1 that is set to b says so.
const MODE_B: u8 = 1;

/// Reads the file in which libsurvive keeps its base stations: JSON without outer braces and
/// without commas between objects, numbers in quotes. Entries whose position or calibration is
/// not set are left out.
///
/// # Errors
/// The text cannot be read as such a file, an entry is incomplete, or no entry is usable.
pub fn parse_libsurvive(text: &str) -> Result<Vec<BaseStation>, BaseStationError> {
    let entries = Reader::new(text).members(0)?;
    let generation = generation(&entries);
    let mut stations = Vec::new();
    for (name, value) in &entries {
        let Value::Object(fields) = value else {
            continue;
        };
        if name.starts_with("lighthouse") {
            stations.extend(station(&Entry { name, fields }, generation)?);
        }
    }
    if stations.is_empty() {
        return Err(BaseStationError::Empty);
    }
    stations.sort_by_key(|station: &BaseStation| station.source);
    if generation == Generation::One {
        // Captures have b flash first, beside A and beside c. A lone one may be either; its broadcast
        // will tell.
        stations.sort_by_key(|station| station.source != Source::Slot(MODE_B));
        for (rank, station) in stations.iter_mut().enumerate() {
            let lone_c = station.source == Source::Slot(2);
            station.source = Source::Slot(u8::from(rank > 0 || lone_c));
        }
    }
    if let Some(pair) = stations
        .windows(2)
        .find(|pair| pair[0].source == pair[1].source)
    {
        return Err(BaseStationError::SharedChannel(pair[0].source));
    }
    Ok(stations)
}

/// Which generation a file is about. Old files do not say it: modes of generation 1 are 0 to 2, and
/// its light planes have no ogee.
fn generation(entries: &[(String, Value)]) -> Generation {
    let scalar = |fields: &[(String, Value)], wanted: &str| {
        let number = fields.iter().find_map(|(name, value)| match value {
            Value::Scalar(text) if name == wanted => text.parse::<u8>().ok(),
            _ => None,
        });
        number.unwrap_or(0)
    };
    let second = |value: &Value| match value {
        Value::Object(fields) => {
            scalar(fields, "mode") > 2
                || fields.iter().any(|(name, value)| match value {
                    Value::Array(items) if name == "fcalogeemag" => {
                        items.iter().any(|item| item.parse() != Ok(0.0f64))
                    }
                    _ => false,
                })
        }
        _ => false,
    };
    let said = ["lighthouse-gen", "configed-lighthouse-gen"].map(|name| scalar(entries, name));
    if said.contains(&2) {
        Generation::Two
    } else if said.contains(&1) || !entries.iter().any(|(_, value)| second(value)) {
        Generation::One
    } else {
        Generation::Two
    }
}

/// A parsed value of the loose JSON.
#[derive(Debug)]
enum Value {
    /// Text or a number, as written.
    Scalar(String),
    Array(Vec<String>),
    Object(Vec<(String, Value)>),
}

struct Entry<'a> {
    name: &'a str,
    fields: &'a [(String, Value)],
}

impl Entry<'_> {
    fn error(&self, what: &'static str) -> BaseStationError {
        BaseStationError::Entry {
            entry: self.name.to_owned(),
            what,
        }
    }

    fn scalar(&self, key: &str) -> Option<&str> {
        self.fields.iter().find_map(|(name, value)| match value {
            Value::Scalar(text) if name == key => Some(text.as_str()),
            _ => None,
        })
    }

    fn flag(&self, key: &str) -> bool {
        self.scalar(key) == Some("1")
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>, BaseStationError> {
        let found = self.fields.iter().find_map(|(name, value)| match value {
            Value::Array(items) if name == key => Some(items),
            _ => None,
        });
        let Some(items) = found else { return Ok(None) };
        if items.len() < N {
            return Err(self.error("an array is too short"));
        }
        let mut numbers = [0.0; N];
        for (slot, text) in numbers.iter_mut().zip(items) {
            *slot = match text.parse::<f64>() {
                Ok(number) if number.is_finite() => number,
                _ => return Err(self.error("an array holds something that is not a number")),
            };
        }
        Ok(Some(numbers))
    }
}

fn station(
    entry: &Entry<'_>,
    generation: Generation,
) -> Result<Option<BaseStation>, BaseStationError> {
    if !entry.flag("PositionSet") || !entry.flag("OOTXSet") {
        return Ok(None);
    }
    let id = entry
        .scalar("id")
        .and_then(|text| text.parse::<i64>().ok())
        .unwrap_or(0) as u32;
    let mode = entry
        .scalar("mode")
        .and_then(|text| text.parse::<u8>().ok())
        .filter(|&mode| mode < 16)
        .ok_or_else(|| entry.error("`mode` is not a number from 0 to 15"))?;
    let pose: [f64; 7] = entry
        .numbers("pose")?
        .ok_or_else(|| entry.error("`pose` is missing"))?;
    let [x, y, z, qw, qx, qy, qz] = pose;
    let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
    if (rotation.length() - 1.0).abs() > 0.01 {
        return Err(entry.error("`pose` does not end in a unit quaternion w, x, y, z"));
    }
    let mut calibration = [PlaneCalibration::default(); 2];
    let mut fill = |key, slot: fn(&mut PlaneCalibration) -> &mut f64| {
        let values: [f64; 2] = entry.numbers(key)?.unwrap_or_default();
        for (plane, value) in calibration.iter_mut().zip(values) {
            *slot(plane) = value;
        }
        Ok(())
    };
    fill("fcalphase", |plane| &mut plane.phase)?;
    fill("fcaltilt", |plane| &mut plane.tilt)?;
    fill("fcalcurve", |plane| &mut plane.curve)?;
    fill("fcalgibpha", |plane| &mut plane.gibphase)?;
    fill("fcalgibmag", |plane| &mut plane.gibmag)?;
    fill("fcalogeephase", |plane| &mut plane.ogeephase)?;
    fill("fcalogeemag", |plane| &mut plane.ogeemag)?;
    let turn = from_z_up();
    Ok(Some(BaseStation {
        source: match generation {
            Generation::One => Source::Slot(mode),
            Generation::Two => Source::Channel(mode),
        },
        id,
        position: turn * DVec3::new(x, y, z),
        rotation: (turn * rotation).normalize(),
        calibration,
    }))
}

/// Reads the loose JSON: commas count as blanks, so that they may be missing.
struct Reader<'a> {
    rest: &'a str,
    line: usize,
}

impl<'a> Reader<'a> {
    fn new(text: &'a str) -> Self {
        Self {
            rest: text,
            line: 1,
        }
    }

    fn error(&self, what: &'static str) -> BaseStationError {
        BaseStationError::Syntax {
            line: self.line,
            what,
        }
    }

    /// The next character that is no blank.
    fn peek(&mut self) -> Option<char> {
        while let Some(c) = self.rest.chars().next() {
            if !c.is_whitespace() && c != ',' {
                return Some(c);
            }
            self.step(c);
        }
        None
    }

    fn step(&mut self, c: char) {
        self.line += usize::from(c == '\n');
        self.rest = &self.rest[c.len_utf8()..];
    }

    fn take(&mut self, wanted: char) -> bool {
        let hit = self.peek() == Some(wanted);
        if hit {
            self.step(wanted);
        }
        hit
    }

    fn members(&mut self, depth: usize) -> Result<Vec<(String, Value)>, BaseStationError> {
        // Outer braces are allowed, so that strict JSON is read too.
        if depth == 0 {
            self.take('{');
        }
        let mut members = Vec::new();
        loop {
            match self.peek() {
                None if depth == 0 => return Ok(members),
                None => return Err(self.error("the text ends inside an object")),
                Some('}') => {
                    self.step('}');
                    return Ok(members);
                }
                Some(_) => {}
            }
            let key = self.scalar()?;
            if !self.take(':') {
                return Err(self.error("a `:` is missing after a key"));
            }
            members.push((key, self.value(depth)?));
        }
    }

    fn value(&mut self, depth: usize) -> Result<Value, BaseStationError> {
        const DEPTH_MAX: usize = 4;
        if self.take('{') {
            if depth == DEPTH_MAX {
                return Err(self.error("objects are nested too deep"));
            }
            return Ok(Value::Object(self.members(depth + 1)?));
        }
        if !self.take('[') {
            return Ok(Value::Scalar(self.scalar()?));
        }
        let mut items = Vec::new();
        while !self.take(']') {
            items.push(self.scalar()?);
        }
        Ok(Value::Array(items))
    }

    fn scalar(&mut self) -> Result<String, BaseStationError> {
        if self.take('"') {
            let end = self
                .rest
                .find('"')
                .ok_or_else(|| self.error("a quote is not closed"))?;
            let text = self.rest[..end].to_owned();
            self.line += text.matches('\n').count();
            self.rest = &self.rest[end + 1..];
            return Ok(text);
        }
        self.peek();
        let ends = |c: char| c.is_whitespace() || matches!(c, ',' | ':' | '{' | '}' | '[' | ']');
        let end = self.rest.find(ends).unwrap_or(self.rest.len());
        if end == 0 {
            return Err(self.error("a key or a value is missing"));
        }
        let text = self.rest[..end].to_owned();
        self.rest = &self.rest[end..];
        Ok(text)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// In the layout of libsurvive's own files, two stations, the second not yet placed.
    const LOOSE: &str = r#""v":"0",
"poser":"MPFIT"
"lighthouse0":{
"index":"0",
"id":"-1529100124",
"mode":"6",
"pose":["1.0","2.0","3.0","1.0","0.0","0.0","0.0"],
"fcalphase":["0.000000","-0.002159"],
"fcalcurve":["-0.067078","0.295410"],
"OOTXSet":"1",
"PositionSet":"1"
}
"lighthouse1":{
"index":"1",
"mode":"9",
"OOTXSet":"1",
"PositionSet":"0"
}
"#;

    #[test]
    fn reads_the_loose_form_and_turns_the_world() {
        let stations = parse_libsurvive(LOOSE).unwrap();
        assert_eq!(stations.len(), 1);
        let station = stations[0];
        assert_eq!(station.source, Source::Channel(6));
        assert_eq!(station.id, 2_765_867_172);
        assert!((station.position - DVec3::new(1.0, 3.0, -2.0)).length() < 1e-12);
        // What was up in libsurvive's world is up in posed's.
        assert!((station.rotation * DVec3::Z - DVec3::Y).length() < 1e-12);
        assert_eq!(station.calibration[1].phase, -0.002_159);
        assert_eq!(station.calibration[0].curve, -0.067_078);
        assert_eq!(station.calibration[0].tilt, 0.0);
    }

    #[test]
    fn reads_strict_json_too() {
        let strict = LOOSE
            .replace("\"MPFIT\"", "\"MPFIT\",")
            .replace("}\n\"", "},\n\"");
        let strict = format!("{{{strict}}}");
        assert_eq!(parse_libsurvive(&strict), parse_libsurvive(LOOSE));
    }

    #[test]
    fn says_what_is_wrong_and_where() {
        let torn = LOOSE.replace("\"mode\":\"6\"", "\"mode\":\"66\"");
        let error = parse_libsurvive(&torn).unwrap_err().to_string();
        assert!(
            error.contains("lighthouse0") && error.contains("mode"),
            "{error}"
        );
        let error = parse_libsurvive(&LOOSE.replace("\"poser\":", "\"poser\"")).unwrap_err();
        assert!(
            matches!(error, BaseStationError::Syntax { line: 2, .. }),
            "{error}"
        );
        let (_, first) = LOOSE.split_once("\"lighthouse0\"").unwrap();
        let (first, _) = first.split_once("\"lighthouse1\"").unwrap();
        let twice = format!("\"lighthouse0\"{first}\"lighthouse1\"{first}");
        assert_eq!(
            parse_libsurvive(&twice),
            Err(BaseStationError::SharedChannel(Source::Channel(6)))
        );
        assert_eq!(parse_libsurvive(""), Err(BaseStationError::Empty));
        let nan = LOOSE.replace("\"2.0\"", "\"nan\"");
        assert!(matches!(
            parse_libsurvive(&nan),
            Err(BaseStationError::Entry { .. })
        ));
    }

    proptest! {
        #[test]
        fn any_text_gives_an_answer(text in ".{0,300}") {
            let _ = parse_libsurvive(&text);
        }

        #[test]
        fn a_torn_file_gives_an_answer(cut in 0usize..600) {
            let cut = cut.min(LOOSE.len());
            let _ = parse_libsurvive(&LOOSE[..cut]);
        }
    }
}
