// A store in a directory of its own, and meshes to put there.

#ifndef TESTS_UNIT_STORE_FIXTURE_H_
#define TESTS_UNIT_STORE_FIXTURE_H_

#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <set>
#include <sstream>
#include <string>
#include <utility>

#include "server/store/mesh_store.h"

namespace deltaray {

// A new directory, removed at the end.
class ScratchDirectory {
 public:
  ScratchDirectory() {
    std::string pattern = ::testing::TempDir() + "deltaray_store_XXXXXX";
    path_ = mkdtemp(pattern.data());
  }
  ~ScratchDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

inline std::unique_ptr<MeshStore> OpenStore(const std::string& path, MeshStore::Options options = {}) {
  options.data_directory = path;
  if (options.build_threads == 0) options.build_threads = 2;
  absl::StatusOr<std::unique_ptr<MeshStore>> store = MeshStore::Open(options);
  EXPECT_TRUE(store.ok()) << store.status();
  return store.ok() ? *std::move(store) : nullptr;
}

// An OBJ file of a strip of 2 · `squares` triangles; every number gives another mesh.
inline std::string StripObj(int number, int squares = 2) {
  std::ostringstream obj;
  obj << "o strip\n";
  for (int i = 0; i <= squares; ++i) obj << "v " << i << " 0 " << number << "\nv " << i << " 1 " << number << "\n";
  for (int i = 0; i < squares; ++i)
    obj << "f " << 2 * i + 1 << " " << 2 * i + 3 << " " << 2 * i + 4 << " " << 2 * i + 2 << "\n";
  return obj.str();
}

inline absl::StatusOr<Upload::Committed> Put(MeshStore& store, const std::string& bytes, const std::string& name = "",
                                             std::optional<Config> config = std::nullopt) {
  absl::StatusOr<std::unique_ptr<Upload>> upload = store.StartUpload();
  if (!upload.ok()) return upload.status();
  if (absl::Status status = (*upload)->Append(bytes); !status.ok()) return status;
  Upload::CommitOptions options;
  options.name = name;
  options.config = config;
  return (*upload)->Commit(std::move(options));
}

inline std::future<absl::StatusOr<MeshStore::Answer>> FutureTree(MeshStore& store, const std::string& mesh,
                                                                 bool final) {
  auto promise = std::make_shared<std::promise<absl::StatusOr<MeshStore::Answer>>>();
  if (const absl::Status found = store.Resolve(mesh).status(); found.ok()) {
    store.WithTree(mesh, final, [promise](absl::StatusOr<MeshStore::Answer> answer) { promise->set_value(answer); });
  } else {
    promise->set_value(found);
  }
  return promise->get_future();
}

inline absl::StatusOr<MeshStore::Answer> AwaitTree(MeshStore& store, const std::string& mesh, bool final = true) {
  return FutureTree(store, mesh, final).get();
}

// The hit of the ray that comes down on x = 0.25, y = 0.5 of a strip from 1 above it: t is 1 for each strip.
inline Hit HitStrip(const MeshStore::Answer& answer, int number) {
  Ray ray;
  ray.origin = {0.25f, 0.5f, static_cast<float>(number) + 1};
  ray.direction = {0, 0, -1};
  Hit hit;
  answer.snapshot->tree->ClosestHits({&ray, 1}, {}, {&hit, 1});
  return hit;
}

// The files below a data directory, as paths relative to it, without the lock, which stays where it is.
inline std::set<std::string> FilesIn(const std::string& path) {
  std::set<std::string> files;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(path)) {
    if (entry.is_regular_file() && entry.path().filename() != "lock")
      files.insert(std::filesystem::relative(entry.path(), path).string());
  }
  return files;
}

inline std::string ReadFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream content;
  content << file.rdbuf();
  return content.str();
}

inline void WriteFile(const std::string& path, const std::string& content) {
  std::filesystem::remove(path);  // some file systems sync a file that is written over
  std::ofstream(path, std::ios::binary | std::ios::trunc) << content;
}

}  // namespace deltaray

#endif  // TESTS_UNIT_STORE_FIXTURE_H_
