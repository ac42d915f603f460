//! gzip and zip around a DEM: unpacked to a temporary file (in `TMPDIR`), which goes when the
//! source does. What is written is bounded by [`MAX_UNPACKED_BYTES`], whatever the file claims.

use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;
use tempfile::TempDir;
use zip::ZipArchive;
use zip::result::ZipError;

use super::detect::{self, HEAD_BYTES, Head, Kind, kind_of};
use super::esri_header::header_of;
use super::hgt::Hgt;
use super::open::open_nested;
use super::side::{self, MAX_SIDE_BYTES, SIDE_EXTENSIONS};
use super::{DemError, DemInfo, DemSource, MAX_UNPACKED_BYTES, OpenOptions};

/// A zip in a gzip in a zip is as far as it goes.
const MOST_NESTED: u32 = 3;
/// The most members of a zip.
const MOST_MEMBERS: usize = 1 << 16;

pub(super) type Archive = ZipArchive<BufReader<File>>;

/// A temporary folder with what came out of a packed file, and how to speak of it.
pub(super) struct Spool {
    folder: TempDir,
    /// Name of the DEM in the folder.
    name: String,
    /// The packed file.
    outer: PathBuf,
    /// What errors call the folder, and the DEM in it.
    shown: [PathBuf; 2],
    /// GDAL's names of both, for commands.
    gdal: [String; 2],
}

impl Spool {
    fn new(
        outer: &Path,
        name: &str,
        shown: [PathBuf; 2],
        gdal: [String; 2],
    ) -> Result<Self, DemError> {
        let folder = tempfile::Builder::new().prefix("escarp-").tempdir();
        let folder = folder.map_err(|e| cannot_write(outer, e))?;
        Ok(Self {
            folder,
            name: name.into(),
            outer: outer.into(),
            shown,
            gdal,
        })
    }

    /// A file that stands for `outer`, which GDAL calls `gdal`.
    fn instead(outer: &Path, name: &str, gdal: String) -> Result<Self, DemError> {
        let folder = outer.parent().unwrap_or(Path::new("")).to_path_buf();
        let gdal = [folder.display().to_string(), gdal];
        Self::new(outer, name, [folder, outer.into()], gdal)
    }

    /// A file that stands for `outer`: for what another program writes.
    pub fn converted(outer: &Path, name: &str) -> Result<Self, DemError> {
        Self::instead(outer, name, outer.display().to_string())
    }

    /// The unpacked DEM.
    pub fn file(&self) -> PathBuf {
        self.folder.path().join(&self.name)
    }

    /// Copies until the end, at most [`MAX_UNPACKED_BYTES`].
    fn write(&self, name: &str, mut from: impl Read) -> Result<(), DemError> {
        let path = self.folder.path().join(name);
        let mut file = File::create(path).map_err(|e| cannot_write(&self.outer, e))?;
        let mut buffer = vec![0; 1 << 16];
        let mut bytes = 0;
        loop {
            let read = from.read(&mut buffer).map_err(|e| self.damaged(&e))?;
            if read == 0 {
                return Ok(());
            }
            bytes += read as u64;
            if bytes > MAX_UNPACKED_BYTES {
                return Err(too_large(&self.shown[1], bytes));
            }
            file.write_all(&buffer[..read])
                .map_err(|e| cannot_write(&self.outer, e))?;
        }
    }

    fn damaged(&self, error: &std::io::Error) -> DemError {
        let expected = "sound packed data (is the file cut short?)";
        DemError::damaged(
            &self.shown[1],
            "the packed data",
            error.to_string(),
            expected,
        )
    }

    /// Brings side files from beside the packed file, where it had none in it. They bear the
    /// name of the DEM or of the packed file, perhaps with the format after it: `a_asc.zip`.
    fn take_side_files(&self) -> Result<(), DemError> {
        let inner = self.file();
        let outer_stem = self.outer.file_stem().unwrap_or_default().to_string_lossy();
        let format = inner.extension().unwrap_or_default().to_string_lossy();
        let bare = outer_stem.strip_suffix(&format!("_{format}"));
        let own = inner.file_stem().unwrap_or_default().to_string_lossy();
        let stems = [Some(&*own), Some(&*outer_stem), bare];
        for extension in SIDE_EXTENSIONS {
            if side::beside(&inner, &[extension]).is_some() {
                continue;
            }
            let candidate = |stem: &str| {
                let beside = self.outer.with_file_name(format!("{stem}.none"));
                side::beside(&beside, &[extension])
            };
            let Some(found) = stems.into_iter().flatten().find_map(candidate) else {
                continue;
            };
            if std::fs::metadata(&found).is_ok_and(|m| m.len() <= MAX_SIDE_BYTES) {
                let to = inner.with_extension(extension);
                std::fs::copy(&found, to).map_err(|e| DemError::io(&found, "read", e))?;
            }
        }
        Ok(())
    }

    /// An error that speaks of what the user knows instead of the temporary file.
    fn rename(&self, error: DemError) -> DemError {
        let folder = self.folder.path();
        let path = |path: PathBuf| match path.strip_prefix(folder) {
            Ok(inner) if inner == Path::new(&self.name) => self.shown[1].clone(),
            Ok(inner) => self.shown[0].join(inner),
            Err(_) => path,
        };
        let (file, folder) = (
            self.file().display().to_string(),
            folder.display().to_string(),
        );
        let [gdal_folder, gdal_file] = &self.gdal;
        error.renamed(path, |text| {
            text.replace(&file, gdal_file).replace(&folder, gdal_folder)
        })
    }

    /// Opens the DEM in it.
    ///
    /// # Errors
    /// Those of the DEM, in the names that the user knows.
    pub fn open(
        self,
        opened: impl FnOnce(&Path) -> Result<Box<dyn DemSource>, DemError>,
    ) -> Result<Box<dyn DemSource>, DemError> {
        let inner = opened(&self.file()).map_err(|error| self.rename(error))?;
        let info = DemInfo {
            path: self.outer.clone(),
            ..inner.info().clone()
        };
        Ok(Box::new(Unpacked {
            inner,
            info,
            spool: self,
        }))
    }
}

/// A source whose file is temporary.
struct Unpacked {
    // Dropped before the folder, which some systems only remove once its files are closed.
    inner: Box<dyn DemSource>,
    info: DemInfo,
    spool: Spool,
}

impl DemSource for Unpacked {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        let read = self.inner.read_rows(first_row, rows, out);
        read.map_err(|error| self.spool.rename(error))
    }

    fn data_columns(&self, first_row: u32, rows: u32) -> Vec<Range<u32>> {
        self.inner.data_columns(first_row, rows)
    }

    fn read_window(
        &mut self,
        rows: Range<u32>,
        columns: Range<u32>,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        let read = self.inner.read_window(rows, columns, out);
        read.map_err(|error| self.spool.rename(error))
    }

    fn block_shape(&self) -> [u32; 2] {
        self.inner.block_shape()
    }
}

/// Opens what is in a gzip.
///
/// # Errors
/// [`DemError::Damaged`], [`DemError::Limits`]; those of the DEM in it.
pub(super) fn open_gzip(
    path: &Path,
    options: &OpenOptions,
    depth: u32,
) -> Result<Box<dyn DemSource>, DemError> {
    check_depth(path, depth)?;
    if options.raw.is_none() {
        refuse_unknown(path)?;
    }
    let spool = gunzip(path)?;
    spool.take_side_files()?;
    spool.open(|file| open_nested(file, options, depth + 1))
}

/// Calls with a file, unpacked if it is a gzip.
///
/// # Errors
/// Those of the call, and of unpacking.
pub(super) fn with_plain<T>(
    path: &Path,
    call: &mut dyn FnMut(&Path) -> Result<T, DemError>,
) -> Result<T, DemError> {
    if kind_of(path, &Head::read(path)?) != Some(Kind::Gzip) {
        return call(path);
    }
    let spool = gunzip(path)?;
    call(&spool.file()).map_err(|error| spool.rename(error))
}

/// Looks at the first bytes in a gzip, so that what is no DEM is not unpacked at all.
fn refuse_unknown(path: &Path) -> Result<(), DemError> {
    let inner = path.with_file_name(inner_name(path));
    let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
    let mut bytes = Vec::new();
    let first = MultiGzDecoder::new(BufReader::new(file))
        .take(HEAD_BYTES)
        .read_to_end(&mut bytes);
    first.map_err(|e| {
        let expected = "sound packed data (is the file cut short?)";
        DemError::damaged(path, "the packed data", e.to_string(), expected)
    })?;
    let length = match bytes.len() as u64 {
        HEAD_BYTES => u64::MAX, // or more than is known of
        all => all,
    };
    let head = Head { bytes, length };
    let described = || header_of(&inner).is_some();
    match kind_of(&inner, &head).is_some() || described() {
        true => Ok(()),
        false => Err(detect::unknown(path, &head)),
    }
}

/// The name of what is in a gzip: without `.gz`.
fn inner_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    match name.rsplit_once('.') {
        Some((stem, "gz" | "GZ")) if !stem.is_empty() => stem.to_string(),
        _ => format!("{name}.unpacked"),
    }
}

fn gunzip(path: &Path) -> Result<Spool, DemError> {
    let inner = inner_name(path);
    let gdal = format!("/vsigzip/{}", path.display());
    let spool = Spool::instead(path, &inner, gdal)?;
    let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
    spool.write(&inner, MultiGzDecoder::new(BufReader::new(file)))?;
    Ok(spool)
}

/// A member of a zip.
struct Member {
    index: usize,
    name: String,
    kind: Kind,
}

/// Opens the one DEM in a zip, with the side files of the same name that are in it or beside it.
///
/// # Errors
/// [`DemError::NotADem`] for a zip without a DEM, [`DemError::Usage`] for one with several, naming
/// them; [`DemError::Damaged`], [`DemError::Limits`]; those of the DEM.
pub(super) fn open_zip(
    path: &Path,
    options: &OpenOptions,
    depth: u32,
) -> Result<Box<dyn DemSource>, DemError> {
    check_depth(path, depth)?;
    let mut archive = archive(path)?;
    if archive.len() > MOST_MEMBERS {
        let found = archive.len() as u64;
        return Err(DemError::limits(
            path,
            "its count",
            found,
            MOST_MEMBERS as u64,
            "members",
        ));
    }
    let member = match &options.raw {
        Some(_) => only(path, raw_members(&archive))?,
        None => the_dem(path, &mut archive)?,
    };
    if member.kind == Kind::Hgt {
        // Decompressed in memory when it is read: a mosaic looks at many that it never reads.
        return Ok(Box::new(Hgt::open_zip(
            path,
            member.index,
            &member.name,
            options,
        )?));
    }
    let name = base_name(&member.name);
    let whole = member.name.trim_start_matches('/');
    let folder = whole
        .strip_suffix(&name)
        .unwrap_or_default()
        .trim_end_matches('/');
    let gdal = format!("/vsizip/{}/", path.display());
    let gdal = [format!("{gdal}{folder}"), format!("{gdal}{whole}")];
    let gdal = gdal.map(|name| name.trim_end_matches('/').to_string());
    let spool = Spool::new(path, &name, [path.into(), path.join(&name)], gdal)?;
    extract(&mut archive, &member, &spool)?;
    spool.take_side_files()?;
    spool.open(|file| open_nested(file, options, depth + 1))
}

/// A member's name; one that is no text is told by its place only.
fn name_of<R: Read>(file: &zip::read::ZipFile<'_, R>) -> String {
    file.name()
        .map(|name| name.into_owned())
        .unwrap_or_default()
}

/// The last part of a member's name, without what a path could do with it.
fn base_name(name: &str) -> String {
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    match last {
        "" | "." | ".." => "member".into(),
        last => last.replace('\0', "_"),
    }
}

/// Folder and stem, by which side files are told; in lower case.
fn stem(name: &str) -> String {
    let base = base_name(name);
    let stem = base.split('.').next().unwrap_or_default();
    let folder = &name[..name.len().saturating_sub(base.len())];
    format!("{folder}{stem}").to_ascii_lowercase()
}

/// Writes the DEM and all members of its stem.
fn extract(archive: &mut Archive, member: &Member, spool: &Spool) -> Result<(), DemError> {
    let wanted = stem(&member.name);
    for index in 0..archive.len() {
        let file = archive
            .by_index(index)
            .map_err(|e| zip_error(e, &spool.outer))?;
        let name = name_of(&file);
        if file.is_dir() || (index != member.index && stem(&name) != wanted) {
            continue;
        }
        if file.size() > MAX_UNPACKED_BYTES {
            return Err(too_large(&spool.shown[1], file.size()));
        }
        spool.write(&base_name(&name), file)?;
    }
    Ok(())
}

fn raw_members(archive: &Archive) -> Vec<Member> {
    let named = |index| Some((index, archive.name_for_index(index)?.ok()?.into_owned()));
    let members = (0..archive.len()).filter_map(named);
    let plain =
        members.filter(|(_, name)| !name.ends_with('/') && !side::is_side_file(Path::new(name)));
    plain
        .map(|(index, name)| Member {
            index,
            name,
            kind: Kind::Matrix,
        })
        .collect()
}

/// The one member that is a DEM by its content. Headers count only where no other member of the
/// same name does; packed files, pictures and bare numbers only where nothing else does.
fn the_dem(path: &Path, archive: &mut Archive) -> Result<Member, DemError> {
    let mut members = Vec::new();
    for index in 0..archive.len() {
        let file = archive.by_index(index).map_err(|e| zip_error(e, path))?;
        let (name, length, is_dir) = (name_of(&file), file.size(), file.is_dir());
        let junk = name.starts_with("__MACOSX/") || base_name(&name).starts_with('.');
        if is_dir || junk {
            continue;
        }
        let mut bytes = Vec::new();
        let read = file.take(HEAD_BYTES).read_to_end(&mut bytes);
        read.map_err(|e| {
            let place = format!("zip member {name:?}");
            let expected = "sound packed data (is the file cut short?)";
            DemError::damaged(path, place, e.to_string(), expected)
        })?;
        if let Some(kind) = kind_of(Path::new(&name), &Head { bytes, length }) {
            members.push(Member { index, name, kind });
        }
    }
    let rank = |kind: Kind| match kind {
        kind if kind.is_vague() => 2,
        Kind::Zip | Kind::Gzip => 1,
        _ => 0,
    };
    let best = members
        .iter()
        .map(|m| rank(m.kind))
        .min()
        .unwrap_or_default();
    members.retain(|m| rank(m.kind) == best);
    let others: Vec<String> = members
        .iter()
        .filter(|m| !m.kind.is_header())
        .map(|m| stem(&m.name))
        .collect();
    members.retain(|m| !m.kind.is_header() || !others.contains(&stem(&m.name)));
    only(path, members)
}

fn only(path: &Path, mut members: Vec<Member>) -> Result<Member, DemError> {
    match (members.pop(), members.is_empty()) {
        (Some(one), true) => Ok(one),
        (None, _) => Err(DemError::not_a_dem(path, "a zip with no DEM in it")),
        (Some(last), false) => {
            let mut names: Vec<String> = members.iter().take(8).map(|m| m.name.clone()).collect();
            let more = members.len() - names.len();
            names.push(last.name);
            let more = if more > 0 {
                format!(" and {more} more")
            } else {
                String::new()
            };
            let what = format!("a zip with several DEMs: {}{more}", names.join(", "));
            Err(DemError::usage(
                path,
                what,
                "unzip it, and name those that are wanted",
            ))
        }
    }
}

/// Opens a zip's directory.
///
/// # Errors
/// [`DemError::Damaged`], [`DemError::Io`].
pub(super) fn archive(path: &Path) -> Result<Archive, DemError> {
    let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
    ZipArchive::new(BufReader::new(file)).map_err(|e| zip_error(e, path))
}

pub(super) fn zip_error(error: ZipError, path: &Path) -> DemError {
    match error {
        ZipError::UnsupportedArchive(what) => {
            DemError::unsupported(path, format!("this zip ({what})"), "unzip it first")
        }
        ZipError::Io(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            DemError::io(path, "read", e)
        }
        other => {
            let expected = "a sound zip (is the file cut short?)";
            DemError::damaged(path, "the zip's directory", other.to_string(), expected)
        }
    }
}

fn check_depth(path: &Path, depth: u32) -> Result<(), DemError> {
    if depth < MOST_NESTED {
        return Ok(());
    }
    let what = format!("a packed file in {MOST_NESTED} others");
    Err(DemError::unsupported(path, what, "unpack it first"))
}

fn too_large(path: &Path, found: u64) -> DemError {
    let what = "what it unpacks to (unpack it by other means, if it is meant)";
    DemError::limits(path, what, found, MAX_UNPACKED_BYTES, "bytes")
}

fn cannot_write(path: &Path, error: std::io::Error) -> DemError {
    let doing = "be unpacked to a temporary file (TMPDIR says where)";
    DemError::io(path, doing, error)
}

#[cfg(test)]
mod tests;
