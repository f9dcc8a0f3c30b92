// The warnings of one file.

#ifndef SERVER_MESH_WARNINGS_H_
#define SERVER_MESH_WARNINGS_H_

#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"

namespace deltaray {

// Keeps the first warnings, and counts those past the limit.
class Warnings {
 public:
  void Add(std::string sentence) {
    if (sentences_.size() < kMost - 1) {
      sentences_.push_back(std::move(sentence));
    } else {
      ++left_out_;
    }
  }
  // All kept, and one more that counts the others.
  std::vector<std::string> Take() {
    if (left_out_ > 0) sentences_.push_back(absl::StrCat(left_out_, " more warnings are left out."));
    return std::move(sentences_);
  }

 private:
  static constexpr size_t kMost = 100;
  std::vector<std::string> sentences_;
  uint64_t left_out_ = 0;
};

}  // namespace deltaray

#endif  // SERVER_MESH_WARNINGS_H_
