#include "server/store/durable_file.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <optional>
#include <string>

#include "server/store/upload_file.h"
#include "tests/hindered.h"
#include "tests/unit/store/fixture.h"
#include "tests/unit/store/watched_disk.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(DurableFileTest, AFileIsMovedToItsPlaceWhole) {
  ScratchDirectory directory;
  const std::string place = directory.path() + "/place";
  WriteFile(place, "old");
  {
    absl::StatusOr<TemporaryFile> file = TemporaryFile::Create(directory.path());
    ASSERT_TRUE(file.ok()) << file.status();
    ASSERT_TRUE(file->Append("ne").ok());
    ASSERT_TRUE(file->Append("w").ok());
    ASSERT_TRUE(file->Sync().ok());
    EXPECT_EQ(ReadFile(place), "old");
    ASSERT_TRUE(file->MoveTo(place).ok());
  }
  EXPECT_EQ(ReadFile(place), "new");
  EXPECT_EQ(*ReadSmallFile(place, 3), "new");
  EXPECT_EQ(ReadSmallFile(place, 2).status().code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(FilesIn(directory.path()), ElementsAre("place"));
  ASSERT_TRUE(RemoveFile(place).ok());
  EXPECT_TRUE(RemoveFile(place).ok());
  EXPECT_EQ(RemoveFile(directory.path() + "/no_such_folder/file").code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(FilesIn(directory.path()), IsEmpty());
}

TEST(DurableFileTest, AFileThatWasNotMovedIsRemoved) {
  ScratchDirectory directory;
  {
    absl::StatusOr<TemporaryFile> file = TemporaryFile::Create(directory.path());
    ASSERT_TRUE(file->Append("x").ok());
    EXPECT_EQ(FilesIn(directory.path()).size(), 1u);
  }
  EXPECT_THAT(FilesIn(directory.path()), IsEmpty());
}

TEST(DurableFileTest, OnlyTheTemporariesOfDeadWritersAreAbandoned) {
  ScratchDirectory directory;
  WriteFile(directory.path() + "/left", "of a dead server");
  absl::StatusOr<TemporaryFile> alive = TemporaryFile::Create(directory.path());
  ASSERT_TRUE(alive.ok());
  // However old it is.
  for (const std::string& file : FilesIn(directory.path())) {
    std::filesystem::last_write_time(directory.path() + "/" + file,
                                     std::filesystem::file_time_type::clock::now() - std::chrono::hours(48));
  }
  EXPECT_EQ(RemoveAbandonedFiles(directory.path()), 1u);
  EXPECT_FALSE(std::filesystem::exists(directory.path() + "/left"));
  EXPECT_EQ(FilesIn(directory.path()).size(), 1u);
  EXPECT_TRUE(alive->Sync().ok());
  EXPECT_TRUE(alive->MoveTo(directory.path() + "/place").ok());
}

TEST(DurableFileTest, AnUnnamedFileIsSeenByNobody) {
  ScratchDirectory directory;
  absl::StatusOr<FileDescriptor> file = CreateUnnamedFile(directory.path());
  ASSERT_TRUE(file.ok()) << file.status();
  ASSERT_TRUE(WriteAll(*file, "abc", "x").ok());
  std::string bytes(3, ' ');
  ASSERT_TRUE(ReadAt(*file, 0, bytes, "x").ok());
  EXPECT_EQ(bytes, "abc");
  EXPECT_EQ(ReadAt(*file, 1, bytes, "x").code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(FilesIn(directory.path()), IsEmpty());
}

TEST(DurableFileTest, ATemporaryCanLoseItsNameAndStaysLocked) {
  ScratchDirectory directory;
  absl::StatusOr<TemporaryFile> file = TemporaryFile::Create(directory.path());
  ASSERT_TRUE(file.ok());
  const std::string path = directory.path() + "/" + *FilesIn(directory.path()).begin();
  std::filesystem::create_hard_link(path, path + "x");  // as a network file system keeps what is open
  absl::StatusOr<FileDescriptor> unnamed = std::move(*file).TakeUnnamed();
  ASSERT_TRUE(unnamed.ok()) << unnamed.status();
  EXPECT_FALSE(std::filesystem::exists(path));
  EXPECT_EQ(RemoveAbandonedFiles(directory.path()), 0u);
  EXPECT_TRUE(WriteAll(*unnamed, "abc", path).ok());
  unnamed = FileDescriptor();
  EXPECT_EQ(RemoveAbandonedFiles(directory.path()), 1u);
}

TEST(DurableFileTest, MakesFoldersAboveToo) {
  ScratchDirectory directory;
  EXPECT_TRUE(MakeFolder(directory.path() + "/a/b/c/").ok());
  EXPECT_TRUE(std::filesystem::is_directory(directory.path() + "/a/b/c"));
  EXPECT_TRUE(MakeFolder(directory.path() + "/a/b/c").ok());
  WriteFile(directory.path() + "/file", "");
  EXPECT_FALSE(MakeFolder(directory.path() + "/file").ok());
  EXPECT_FALSE(MakeFolder(directory.path() + "/file/below").ok());
}

TEST(DurableFileTest, AFullDiskIsResourceExhausted) {
  const FileDescriptor full(open("/dev/full", O_WRONLY | O_CLOEXEC));
  ASSERT_TRUE(full.IsOpen());
  const absl::Status status = WriteAll(full, "x", "/dev/full");
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(status.ToString(), HasSubstr("disk full"));
  EXPECT_THAT(status.ToString(), HasSubstr("/dev/full"));
}

TEST(DurableFileTest, ErrorsOfTheSystemKeepTheirMeaning) {
  EXPECT_EQ(FileError(EDQUOT, "write", "x").code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(FileError(EMFILE, "open", "x").code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(FileError(EROFS, "create", "x").code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(FileError(EACCES, "create", "x").code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(FileError(ENOENT, "open", "x").code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(FileError(ENOENT, "open", "no_such_folder/x").code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(FileError(EIO, "read", "x").code(), absl::StatusCode::kInternal);
}

TEST(DurableFileTest, AFileOverTheProcesssLimitIsAnErrorNotASignal) {
  ScratchDirectory directory;
  const FileSizeLimit limit(1000);
  absl::StatusOr<TemporaryFile> file = TemporaryFile::Create(directory.path());
  ASSERT_TRUE(file.ok());
  EXPECT_TRUE(file->Append(std::string(1000, 'x')).ok());
  EXPECT_EQ(file->Append("x").code(), absl::StatusCode::kResourceExhausted);
}

TEST(DurableFileTest, WhatMayNotBeWrittenToIsFailedPrecondition) {
  ScratchDirectory directory;
  const WithoutPrivileges without;
  chmod(directory.path().c_str(), 0500);
  EXPECT_EQ(TemporaryFile::Create(directory.path()).status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(CreateUnnamedFile(directory.path()).status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(MakeFolder(directory.path() + "/sub").code(), absl::StatusCode::kFailedPrecondition);
}

TEST(DurableFileTest, ASandboxThatRefusesToTellIsNoMissingPermission) {
  ScratchDirectory directory;
  for (const int error : {EPERM, ENOSYS}) {
    WatchedDisk disk([error](const DiskCall& call) { return call.kind == DiskCall::kAccess ? error : 0; });
    EXPECT_TRUE(CheckWritable(directory.path()).ok());
    EXPECT_TRUE(CheckLockable(directory.path() + "/lock").ok());
    EXPECT_EQ(CheckWritable(directory.path() + "/gone").code(), absl::StatusCode::kFailedPrecondition);
  }
}

TEST(DurableFileTest, AnUploadIsCountedHashedAndReadWhole) {
  ScratchDirectory directory;
  DiskBudget budget(100, [] { return 0; });
  absl::StatusOr<UploadFile> file = UploadFile::Create(directory.path(), 6, &budget);
  ASSERT_TRUE(file.ok());
  EXPECT_TRUE(file->Append("abc").ok());
  EXPECT_TRUE(file->Append("").ok());
  EXPECT_TRUE(file->Append("def").ok());
  EXPECT_EQ(file->size(), 6u);
  Sha256 sha256;
  sha256.Update("abcdef");
  EXPECT_EQ(*file->Finish(), sha256.Finish());
  std::string read;
  EXPECT_TRUE(file->Read([&](std::span<const char> bytes) {
                    read.assign(bytes.begin(), bytes.end());
                    return absl::OkStatus();
                  })
                  .ok());
  EXPECT_EQ(read, "abcdef");
  EXPECT_THAT(FilesIn(directory.path()), IsEmpty());
}

TEST(DurableFileTest, AnUploadOverItsLimitStaysRefused) {
  ScratchDirectory directory;
  DiskBudget budget(100, [] { return 0; });
  absl::StatusOr<UploadFile> file = UploadFile::Create(directory.path(), 6, &budget);
  EXPECT_TRUE(file->Append("abcdef").ok());
  const absl::Status status = file->Append("g");
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(status.ToString(), HasSubstr("--max-upload-bytes"));
  EXPECT_EQ(file->Append("").code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(file->Finish().status().code(), absl::StatusCode::kResourceExhausted);
}

TEST(DurableFileTest, UploadsTogetherStayWithinTheBytesOnDisk) {
  ScratchDirectory directory;
  DiskBudget budget(10, [] { return 4; });
  absl::StatusOr<UploadFile> one = UploadFile::Create(directory.path(), 100, &budget);
  {
    absl::StatusOr<UploadFile> two = UploadFile::Create(directory.path(), 100, &budget);
    EXPECT_TRUE(one->Append("abc").ok());
    EXPECT_TRUE(two->Append("abc").ok());
    const absl::Status status = two->Append("d");
    EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
    EXPECT_THAT(status.ToString(), HasSubstr("10 bytes on disk (--max-stored-bytes)"));
  }
  {
    // What was refused takes no room of others.
    absl::StatusOr<UploadFile> refused = UploadFile::Create(directory.path(), 100, &budget);
    EXPECT_FALSE(refused->Append("abcdef").ok());
    absl::StatusOr<UploadFile> two = UploadFile::Create(directory.path(), 100, &budget);
    EXPECT_TRUE(two->Append("abc").ok());
  }
  EXPECT_TRUE(one->Append("def").ok());
}

TEST(DurableFileTest, WhatHasArrivedCountsOnce) {
  uint64_t stored = 0;
  DiskBudget budget(10, [&] { return stored; });
  DiskBudget::Charge arriving(&budget), other(&budget);
  ASSERT_TRUE(arriving.Add(6).ok());
  EXPECT_FALSE(other.Add(5).ok());
  arriving.GiveBack([&] { stored = 6; });
  EXPECT_FALSE(other.Add(5).ok());
  EXPECT_TRUE(other.Add(4).ok());
}

TEST(DurableFileTest, Sha256IsTheStandards) {
  EXPECT_EQ(Sha256::Hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

}  // namespace
}  // namespace deltaray
